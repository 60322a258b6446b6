"""``POST /doctor``: what is wrong with pictures, cameras and state, and what to do."""

import time
from functools import partial

from fastapi import APIRouter, Request
from fastapi.responses import Response

from cspace.bundle.samples import require_robot
from cspace.errors import ImageError
from inference_api.models.served import ServedModel
from inference_api.requests import Service, Serving, both_bodies
from inference_api.routes.sample import answer_responses, prepared_picture
from inference_api.scheduler import Job, rows_of
from inference_api.schemas import (
    DoctorAnswer,
    DoctorTimingMs,
    ScenarioInfo,
    SceneFields,
    SuggestedPoseInfo,
    Verdict,
    model_info,
)
from inference_api.telemetry import Answered

router = APIRouter()


@router.post(
    "/doctor",
    summary="Find what is wrong with depth pictures, cameras and state",
    openapi_extra=both_bodies(SceneFields),
    responses=answer_responses(DoctorAnswer),
)
async def doctor(request: Request, service: Serving) -> Response:
    """Warnings of other answers, and tests that take longer: the arm rendered at `state` against the picture.

    Views that others refuse for seeing nothing in reach are answered. Of a plane only the novelty is given.
    """
    work = partial(_answer, service, began=time.perf_counter())
    return await service.answer(request, SceneFields, work)


def _answer(
    service: Service, request: SceneFields, served: ServedModel, job: Job, *, began: float
) -> Response:
    bundle, image = served.bundle, request.picture()
    world = bundle.spec.world
    require_robot(request.robot, bundle.spec)
    # Fits last long, and are paid for as they compute.
    job.spend(rows_of(pixels=world.pixels_of(image), searches=True))
    found = world.diagnosis(image, job.check_cancelled)
    diagnosed = time.perf_counter()
    try:
        novelty = prepared_picture(service.store, bundle, image, job).picture.novelty
    except ImageError:
        # Nothing in reach, which is among the verdicts.
        novelty = None
    found, ended = found.with_novelty(novelty), time.perf_counter()
    service.metrics.answered(Answered("diagnosis", served))
    body = DoctorAnswer(
        verdicts=[Verdict.model_validate(one, from_attributes=True) for one in found.findings],
        notes=list(found.notes),
        poses=[SuggestedPoseInfo.model_validate(one, from_attributes=True) for one in found.poses],
        scenario=ScenarioInfo(novelty=novelty),
        model=model_info(served),
        timing_ms=DoctorTimingMs(
            diagnose=1e3 * (diagnosed - began),
            novelty=1e3 * (ended - diagnosed),
            total=1e3 * (ended - began),
        ),
    )
    return Response(body.model_dump_json(), media_type="application/json")
