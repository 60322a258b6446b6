"""``POST /validity``: which of the client's own configurations are free in a picture's scenario."""

import time
from collections.abc import Sequence
from itertools import chain
from typing import Annotated

import numpy as np
from fastapi import APIRouter, Depends
from fastapi.responses import Response
from numpy.typing import NDArray

from cspace.bundle.spec import fitted_configurations, require_robot
from cspace.errors import InputError
from cspace.files import read_npy
from cspace_client.wire import MAX_EXPLAINED, MAX_SAMPLES, Contact, ScoreTimingMs, ValidityAnswer
from inference_api.kernels import Kernels
from inference_api.limits import ComputePlace
from inference_api.pictures import PreparedPictures
from inference_api.request_body import body_of, both_bodies
from inference_api.scene import (
    ValidityRequest,
    WantsNpy,
    about,
    has_known,
    json_response,
    npy_response,
    npy_responses,
    robot_of,
    served_for,
    view_of,
    warnings_of,
)
from inference_api.served_models import ServedModel
from inference_api.telemetry import request_fields

# Fewer configurations may well all collide.
MANY_ROWS = 20
HALF = 0.5
_HEADERS = {
    "X-Threshold": "The confidence that training recommends, for models that have one.",
    "Server-Timing": "decode, encode, score and total, in ms.",
}

router = APIRouter()


@router.post(
    "/validity",
    summary="Predict which configurations are free in a picture's scenario",
    openapi_extra=both_bodies(ValidityRequest),
    responses=npy_responses(
        ValidityAnswer,
        "float32 array (configurations, 2): confidence and unseen, NaN for null",
        _HEADERS,
    ),
)
def validity(
    request: Annotated[ValidityRequest, Depends(body_of(ValidityRequest))],
    served: Annotated[ServedModel, Depends(served_for(ValidityRequest))],
    place: ComputePlace,
    pictures: PreparedPictures,
    kernels: Kernels,
    npy: WantsNpy,
) -> Response:
    """The validity head's confidence for each of the configurations, whatever they were drawn by.

    With `Accept: application/x-npy` the answer is a float32 `.npy` of two columns, the rest in headers.
    """
    began = time.perf_counter()
    bundle, spec = served.bundle, served.bundle.spec
    require_robot(robot_of(request), spec)
    configurations = fitted_configurations(_rows(request.configurations), spec)
    if request.explain and len(configurations) > MAX_EXPLAINED:
        raise InputError(
            "there are too many configurations to explain",
            expected=f"at most {MAX_EXPLAINED} with explain",
            got=str(len(configurations)),
            remedy="send those alone that you want to have explained",
        )
    if request.explain or has_known(request):
        kernels.require()
    prepared = pictures.prepare(bundle, view_of(request), place.check_cancelled, request.check_pose)
    picture, scoring = prepared.picture, time.perf_counter()
    confidence, unseen = bundle.predict(picture, configurations, place.check_cancelled)
    ended = time.perf_counter()
    timing = ScoreTimingMs(
        decode=prepared.decode_ms,
        encode=prepared.encode_ms,
        score=1e3 * (ended - scoring),
        total=1e3 * (ended - began),
    )
    colliding = float((confidence < HALF).mean()) if len(confidence) >= MANY_ROWS else 0.0
    warnings = warnings_of(prepared.findings_with(spec.world, colliding=colliding))
    request_fields.get().update(model=str(served), n=len(confidence))
    if npy:
        columns = np.full((len(confidence), 2), np.nan, dtype="<f4")
        columns[:, 0] = confidence
        if unseen is not None:
            columns[:, 1] = unseen
        threshold = spec.confidence_threshold
        headers = {} if threshold is None else {"X-Threshold": f"{threshold:.6g}"}
        return npy_response(columns, served, picture.novelty, warnings, timing, headers)
    why: list[Contact | None] | None = None
    if request.explain:
        why = []
        for row, value in zip(configurations, confidence, strict=True):
            place.check_cancelled()
            contact = None if value >= HALF else spec.world.contact(row, picture.image, picture.known)
            why.append(None if contact is None else Contact.model_validate(contact))
    return json_response(
        ValidityAnswer.model_construct(
            confidence=confidence,
            unseen=unseen,
            threshold=spec.confidence_threshold,
            why=why,
            timing_ms=timing,
            **about(served, picture.novelty, warnings),
        )
    )


def _rows(given: bytes | Sequence[Sequence[float]]) -> NDArray[np.floating]:
    """(n, d), of a ``.npy`` file or of rows."""
    if not isinstance(given, bytes):
        lengths = {len(row) for row in given}
        if len(lengths) > 1:
            raise _wrong(f"rows of {min(lengths)} to {max(lengths)}")
        # Several times as fast as to look into each row for its type.
        flat = np.fromiter(chain.from_iterable(given), np.float64, sum(map(len, given)))
        return flat.reshape(len(given), -1)
    try:
        found = read_npy(given, ("<f4", "<f8"), 2)
    except ValueError as error:
        raise _wrong(str(error)[:200]) from error
    if not 1 <= len(found) <= MAX_SAMPLES:
        raise _wrong(f"{len(found)} rows")
    return found


def _wrong(got: str) -> InputError:
    return InputError(
        "configurations are wrong",
        expected=f"1 to {MAX_SAMPLES} rows of as many angles in rad: JSON, or a .npy of float32 or float64",
        got=got,
        remedy="numpy.save(file, array) writes such a file",
    )
