"""``POST /validity``: which of the client's own configurations are free in a picture's scenario."""

import time
from functools import partial
from itertools import chain

import numpy as np
from fastapi import APIRouter, Request
from fastapi.responses import Response
from numpy.typing import NDArray

from cspace.bundle import Picture
from cspace.bundle.samples import fitted_configurations, require_robot
from cspace.errors import InputError
from cspace.files import read_npy
from cspace.query import MAX_SAMPLES
from cspace.world import World
from inference_api.models.served import ServedModel
from inference_api.requests import Service, Serving, both_bodies, prefers_npy
from inference_api.routes.sample import model_headers, npy_response, npy_responses, prepared_picture
from inference_api.scheduler import Job, rows_of
from inference_api.schemas import (
    MAX_EXPLAINED,
    ContactInfo,
    ScoreTimingMs,
    ValidityAnswer,
    ValidityRequest,
    about,
    warnings_of,
)
from inference_api.telemetry import Answered

# Fewer configurations may well all collide.
MANY_ROWS = 20
HALF = 0.5
_TYPES = ("<f4", "<f8")

router = APIRouter()


@router.post(
    "/validity",
    summary="Predict which configurations are free in a picture's scenario",
    openapi_extra=both_bodies(ValidityRequest),
    responses=npy_responses(
        ValidityAnswer,
        "float32 array (configurations, 2): confidence and unseen, NaN for null",
        {
            "X-Threshold": "The confidence that training recommends, for models that have one.",
            "Server-Timing": "decode, encode, score and total, in ms.",
        },
    ),
)
async def validity(request: Request, service: Serving) -> Response:
    """The validity head's confidence for each of the configurations, whatever they were drawn by.

    With `Accept: application/x-npy` the answer is a float32 `.npy` of two columns, the rest in headers.
    """
    npy, began = prefers_npy(request.headers.get("accept")), time.perf_counter()
    work = partial(_answer, service, npy=npy, began=began)
    return await service.answer(request, ValidityRequest, work)


def _answer(
    service: Service, request: ValidityRequest, served: ServedModel, job: Job, *, npy: bool, began: float
) -> Response:
    store, bundle, spec = service.store, served.bundle, served.bundle.spec
    image, given = request.picture(), _array_of(request.configurations)
    require_robot(request.robot, spec)
    configurations = fitted_configurations(given, spec)
    job.spend(rows_of(rows=len(configurations)))
    if request.explain and len(configurations) > MAX_EXPLAINED:
        raise InputError(
            "there are too many configurations to explain",
            expected=f"at most {MAX_EXPLAINED} with explain",
            got=str(len(configurations)),
            remedy="send those alone that you want to have explained",
        )
    if request.explain or request.has_known:
        store.planner.require()
    prepared = prepared_picture(store, bundle, image, job)
    scoring = time.perf_counter()
    confidence, unseen = bundle.predict(prepared.picture, configurations, job.check_cancelled)
    ended = time.perf_counter()
    timing = ScoreTimingMs(
        decode=prepared.decode_ms,
        encode=prepared.encode_ms,
        score=1e3 * (ended - scoring),
        total=1e3 * (ended - began),
    )
    colliding = float((confidence < HALF).mean()) if len(confidence) >= MANY_ROWS else 0.0
    warnings = warnings_of(prepared.findings_with(spec.world, colliding=colliding))
    novelty = prepared.picture.novelty
    service.metrics.answered(Answered("scores", served, n=len(confidence)))
    if npy:
        columns = np.full((len(confidence), 2), np.nan, dtype="<f4")
        columns[:, 0] = confidence
        if unseen is not None:
            columns[:, 1] = unseen
        headers = model_headers(served, novelty, warnings)
        if spec.confidence_threshold is not None:
            headers["X-Threshold"] = f"{spec.confidence_threshold:.6g}"
        return npy_response(columns, headers, timing)
    # Constructed, not validated: the lists come from arrays.
    body = ValidityAnswer.model_construct(
        confidence=confidence.tolist(),
        unseen=None if unseen is None else unseen.tolist(),
        threshold=spec.confidence_threshold,
        why=_why(prepared.picture, spec.world, configurations, confidence, job) if request.explain else None,
        timing_ms=timing,
        **about(served, novelty, warnings),
    )
    return Response(body.model_dump_json(), media_type="application/json")


def _why(
    picture: Picture,
    world: World,
    configurations: NDArray[np.float32],
    confidence: NDArray[np.float32],
    job: Job,
) -> list[ContactInfo | None]:
    """What is in the way of those that do not pass."""
    found: list[ContactInfo | None] = []
    for row, value in zip(configurations, confidence, strict=True):
        job.check_cancelled()
        contact = None if value >= HALF else world.contact(row, picture.image, picture.known)
        found.append(ContactInfo.of(contact))
    return found


def _array_of(given: bytes | tuple[tuple[float, ...], ...]) -> NDArray[np.floating]:
    """(n, d), of a ``.npy`` file or of rows."""
    if not isinstance(given, bytes):
        lengths = {len(row) for row in given}
        if len(lengths) > 1:
            raise _wrong(f"rows of {min(lengths)} to {max(lengths)}")
        # Several times as fast as to look into each row for its type.
        flat = np.fromiter(chain.from_iterable(given), np.float64, sum(map(len, given)))
        return flat.reshape(len(given), -1)
    try:
        found = read_npy(given, _TYPES, 2)
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
