"""``POST /doctor``: what is wrong with pictures, cameras and state, and what to do."""

import time
from typing import Annotated

from fastapi import APIRouter, Depends
from fastapi.responses import Response

from cspace.bundle.spec import require_robot
from cspace.errors import ImageError
from cspace_client.wire import DoctorAnswer, DoctorTimingMs, ScenarioInfo, SuggestedPose, Verdict
from inference_api.limits import ComputePlace
from inference_api.pictures import PreparedPictures
from inference_api.request_body import body_of, both_bodies
from inference_api.scene import (
    DoctorRequest,
    answer_responses,
    json_response,
    model_info,
    robot_of,
    served_for,
    view_of,
)
from inference_api.served_models import ServedModel
from inference_api.telemetry import request_fields

router = APIRouter()


@router.post(
    "/doctor",
    summary="Find what is wrong with depth pictures, cameras and state",
    openapi_extra=both_bodies(DoctorRequest),
    responses=answer_responses(DoctorAnswer),
)
def doctor(
    request: Annotated[DoctorRequest, Depends(body_of(DoctorRequest))],
    served: Annotated[ServedModel, Depends(served_for(DoctorRequest))],
    place: ComputePlace,
    pictures: PreparedPictures,
) -> Response:
    """Warnings of other answers, and tests that take longer: the arm rendered at `state` against the picture.

    Views that others refuse for seeing nothing in reach are answered. Of a plane only the novelty is given.
    """
    began = time.perf_counter()
    bundle, view = served.bundle, view_of(request)
    require_robot(robot_of(request), bundle.spec)
    found = bundle.spec.world.diagnosis(view, place.check_cancelled)
    diagnosed = time.perf_counter()
    try:
        novelty = pictures.prepare(bundle, view, place.check_cancelled).picture.novelty
    except ImageError:
        # Nothing in reach, which is among the verdicts.
        novelty = None if bundle.spec.novelty_quantiles is None else 1.0
    found, ended = found.with_novelty(novelty), time.perf_counter()
    request_fields.get()["model"] = str(served)
    return json_response(
        DoctorAnswer(
            verdicts=[Verdict.model_validate(one) for one in found.findings],
            notes=list(found.notes),
            poses=[SuggestedPose.model_validate(one) for one in found.poses],
            scenario=ScenarioInfo(novelty=novelty),
            model=model_info(served),
            timing_ms=DoctorTimingMs(
                diagnose=1e3 * (diagnosed - began),
                novelty=1e3 * (ended - diagnosed),
                total=1e3 * (ended - began),
            ),
        )
    )
