"""``POST /belief``: how likely something is in each cell of space, seen or not."""

import base64
import time
from typing import Annotated

import numpy as np
from fastapi import APIRouter, Depends
from fastapi.responses import Response

from cspace.bundle.spec import require_robot
from cspace_client.wire import BeliefAnswer, ScoreTimingMs
from inference_api.limits import ComputePlace
from inference_api.pictures import PreparedPictures
from inference_api.request_body import body_of, both_bodies
from inference_api.scene import (
    BeliefRequest,
    about,
    answer_responses,
    json_response,
    robot_of,
    served_for,
    view_of,
    warnings_of,
)
from inference_api.served_models import ServedModel
from inference_api.telemetry import request_fields

router = APIRouter()


@router.post(
    "/belief",
    summary="Estimate what is in each cell of space",
    openapi_extra=both_bodies(BeliefRequest),
    responses=answer_responses(BeliefAnswer),
)
def belief(
    request: Annotated[BeliefRequest, Depends(body_of(BeliefRequest))],
    served: Annotated[ServedModel, Depends(served_for(BeliefRequest))],
    place: ComputePlace,
    pictures: PreparedPictures,
) -> Response:
    """How likely something is in each cell of space, also where no camera looks. Of arms in space alone."""
    began = time.perf_counter()
    bundle, spec = served.bundle, served.bundle.spec
    require_robot(robot_of(request), spec)
    bundle.require_field()
    prepared = pictures.prepare(bundle, view_of(request), place.check_cancelled)
    asked = time.perf_counter()
    found = bundle.occupancy_grid(prepared.picture)
    ended = time.perf_counter()
    request_fields.get()["model"] = str(served)
    warnings = warnings_of(prepared.findings_with(spec.world, colliding=0.0))
    return json_response(
        BeliefAnswer.model_construct(
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
    )
