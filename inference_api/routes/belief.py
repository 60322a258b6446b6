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
from inference_api.models.store import ModelStore
from inference_api.requests import Serving, both_bodies
from inference_api.routes.sample import answer_responses, prepared_picture
from inference_api.scheduler import Job, rows_of
from inference_api.schemas import (
    BeliefAnswer,
    BeliefRequest,
    ScenarioInfo,
    ScoreTimingMs,
    joint_space_info,
    model_info,
    warnings_of,
)
from inference_api.telemetry import Answered

# Voxels that cost as much as one configuration.
_VOXELS_A_ROW = 128

router = APIRouter()


@router.post(
    "/belief",
    summary="Show what a model takes the whole scene to be",
    openapi_extra=both_bodies(BeliefRequest),
    responses=answer_responses(BeliefAnswer),
)
async def belief(request: Request, service: Serving) -> Response:
    """How likely something is in each cell of space, also where no camera looks. Of arms in space alone."""
    return await service.answer(
        request, BeliefRequest, partial(_answer, service.store, began=time.perf_counter())
    )


def _answer(
    store: ModelStore, request: BeliefRequest, served: ServedModel, job: Job, *, began: float
) -> Response:
    bundle, spec, image = served.bundle, served.bundle.spec, request.picture()
    require_robot(request.robot, spec)
    bundle.require_belief()
    job.spend(rows_of(rows=math.prod(spec.world.sensor.picture_shape[:3]) / _VOXELS_A_ROW))
    prepared = prepared_picture(store, bundle, image, job)
    asked = time.perf_counter()
    found = bundle.belief(prepared.picture, job.check_cancelled)
    ended = time.perf_counter()
    store.observer.answered(Answered("belief", f"{served.name}/{served.version}", served.fallback))
    body = BeliefAnswer(
        low_m=list(found.low_m),
        cell_m=found.cell_m,
        counts=list(found.occupied.shape),
        occupied=base64.b64encode(np.rint(255.0 * found.occupied).astype(np.uint8).tobytes()).decode(),
        scenario=ScenarioInfo(novelty=prepared.picture.novelty),
        warnings=warnings_of(prepared.findings_with(spec.world, colliding=0.0)),
        joint_space=joint_space_info(spec.joint_space),
        model=model_info(served),
        timing_ms=ScoreTimingMs(
            decode=prepared.decode_ms,
            encode=prepared.encode_ms,
            score=1e3 * (ended - asked),
            total=1e3 * (ended - began),
        ),
    )
    return Response(body.model_dump_json(), media_type="application/json")
