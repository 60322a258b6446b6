"""``POST /belief``: what a model takes the whole scene to be, seen or not."""

import base64
import math
import time
from functools import partial

import numpy as np
from fastapi import APIRouter, Request
from fastapi.responses import Response

from cspace.bundle.samples import require_robot
from inference_api.models.served import ServedModel
from inference_api.requests import Service, Serving, both_bodies
from inference_api.routes.sample import answer_responses, prepared_picture
from inference_api.scheduler import Job, rows_of
from inference_api.schemas import BeliefAnswer, SceneFields, ScoreTimingMs, about, warnings_of
from inference_api.telemetry import Answered

# Voxels that cost as much as one configuration.
_VOXELS_A_ROW = 128

router = APIRouter()


@router.post(
    "/belief",
    summary="Show what a model takes the whole scene to be",
    openapi_extra=both_bodies(SceneFields),
    responses=answer_responses(BeliefAnswer),
)
async def belief(request: Request, service: Serving) -> Response:
    """How likely something is in each cell of space, also where no camera looks. Of arms in space alone."""
    work = partial(_answer, service, began=time.perf_counter())
    return await service.answer(request, SceneFields, work)


def _answer(
    service: Service, request: SceneFields, served: ServedModel, job: Job, *, began: float
) -> Response:
    bundle, spec, image = served.bundle, served.bundle.spec, request.picture()
    require_robot(request.robot, spec)
    bundle.require_belief()
    job.spend(rows_of(rows=math.prod(spec.world.sensor.picture_shape[:3]) / _VOXELS_A_ROW))
    prepared = prepared_picture(service.store, bundle, image, job)
    asked = time.perf_counter()
    found = bundle.belief(prepared.picture, job.check_cancelled)
    ended = time.perf_counter()
    service.metrics.answered(Answered("belief", served))
    warnings = warnings_of(prepared.findings_with(spec.world, colliding=0.0))
    body = BeliefAnswer(
        low_m=list(found.low_m),
        cell_m=found.cell_m,
        counts=list(found.occupied.shape),
        occupied=base64.b64encode(np.rint(255.0 * found.occupied).astype(np.uint8).tobytes()).decode(),
        timing_ms=ScoreTimingMs(
            decode=prepared.decode_ms,
            encode=prepared.encode_ms,
            score=1e3 * (ended - asked),
            total=1e3 * (ended - began),
        ),
        **about(served, prepared.picture.novelty, warnings),
    )
    return Response(body.model_dump_json(), media_type="application/json")
