"""``POST /sample``: collision-free configurations for a picture."""

import io
import json
import time
from collections.abc import Sequence
from functools import lru_cache, partial
from math import prod
from typing import Any

import numpy as np
from fastapi import APIRouter, Request
from fastapi.responses import Response
from numpy.typing import NDArray
from pydantic import BaseModel

from cspace.bundle import Bundle
from cspace.bundle.samples import fitted
from inference_api.models.pictures import Prepared
from inference_api.models.served import ServedModel
from inference_api.models.store import ModelStore
from inference_api.problem_types import SAMPLE_PROBLEMS
from inference_api.requests import NPY, Service, Serving, both_bodies, prefers_npy, problem_responses
from inference_api.scheduler import Job, rows_of
from inference_api.schemas import PictureWarning, SampleAnswer, SampleRequest, TimingMs, about, warnings_of
from inference_api.telemetry import Answered

# Proxies take 4 KiB of headers.
MAX_WARNINGS = 2048
_SAMPLE_HEADERS = {
    "X-Seed": "The seed that was used, in decimal.",
    "X-Shortfall": "n minus what was returned.",
    "X-Acceptance": "Share of the generated samples that reached the requested confidence.",
    "Server-Timing": "decode, encode, generate and total, in ms.",
}
_MODEL_HEADERS = {
    "X-Model-Name": "Name of the model that answered.",
    "X-Model-Version": "Its number in the registry, 0 for the shipped model.",
    "X-Model-Digest": "SHA-256 of the bundle's sums.",
    "X-Robot": "`robot` of the model.",
    "X-Alias-Confirmed": "`alias_confirmed` of the model, `true` or `false`.",
    "X-Joint-Space": "`joint_space` of the JSON answer, as JSON.",
    "X-Novelty": "How unlike the training scenarios the picture is, 0 to 1, where the model estimates it.",
    "X-Warnings": "`warnings` of the JSON answer, as JSON; of many the last ones have an empty message.",
}


def npy_responses(
    model: type[BaseModel], array: str, headers: dict[str, str]
) -> dict[int | str, dict[str, Any]]:
    """``responses`` of a route that answers with JSON, or with an array and the rest in headers."""
    described = {
        name: {"description": f"{text} With `Accept: {NPY}` only.", "schema": {"type": "string"}}
        for name, text in (_MODEL_HEADERS | headers).items()
    }
    return answer_responses(model) | {
        200: {
            "description": "JSON, or a `.npy`.",
            "model": model,
            "content": {NPY: {"schema": {"type": "string", "format": "binary", "description": array}}},
            "headers": described | REQUEST_ID_HEADER,
        }
    }


REQUEST_ID_HEADER = {
    "X-Request-ID": {
        "description": "The client's own, or one that the server chose; every answer carries it.",
        "schema": {"type": "string"},
    }
}


def answer_responses(model: type[BaseModel]) -> dict[int | str, dict[str, Any]]:
    """``responses`` of a route that answers a question about a picture with JSON."""
    success = {"description": "The answer.", "model": model, "headers": REQUEST_ID_HEADER}
    return {200: success, **problem_responses(*SAMPLE_PROBLEMS)}


router = APIRouter()


@router.post(
    "/sample",
    summary="Draw collision-free configurations for a picture",
    openapi_extra=both_bodies(SampleRequest),
    responses=npy_responses(SampleAnswer, "float32 array (samples, joints)", _SAMPLE_HEADERS),
)
async def sample(request: Request, service: Serving) -> Response:
    """The same seed, picture, parameters and model digest give the same samples on one machine.

    With `Accept: application/x-npy` the answer is the samples alone as a float32 `.npy`, the rest in headers.
    """
    npy, began = prefers_npy(request.headers.get("accept")), time.perf_counter()
    work = partial(_answer, service, npy=npy, began=began)
    return await service.answer(request, SampleRequest, work)


def _answer(
    service: Service, request: SampleRequest, served: ServedModel, job: Job, *, npy: bool, began: float
) -> Response:
    store, bundle, spec = service.store, served.bundle, served.bundle.spec
    query = fitted(request.query(), spec, has_validity=bundle.has_validity)
    if request.has_known:
        store.planner.require()
    with job.sampling(spec, query) as check_cancelled:
        prepared = prepared_picture(store, bundle, request.picture(), job)
        # A ``.npy`` holds samples alone: nobody would see the scores of those that are not filtered.
        found = bundle.answer(
            prepared.picture, query, report_confidence=not npy, check_cancelled=check_cancelled
        )
    # Without a confidence to reach all are taken.
    warnings = warnings_of(prepared.findings_with(spec.world, colliding=1.0 - found.acceptance))
    novelty = prepared.picture.novelty
    timing = TimingMs(
        decode=prepared.decode_ms,
        encode=prepared.encode_ms,
        generate=found.generate_ms,
        total=1e3 * (time.perf_counter() - began),
    )
    answered = Answered(
        "samples",
        served,
        n=query.n,
        seed=query.seed,
        shortfall=found.shortfall,
        acceptance=found.acceptance,
        stages_s={stage: 1e-3 * value for stage, value in timing.model_dump().items()},
    )
    service.metrics.answered(answered)
    if npy:
        headers = model_headers(served, novelty, warnings) | {
            "X-Seed": str(query.seed),
            "X-Shortfall": str(found.shortfall),
            "X-Acceptance": f"{found.acceptance:.6g}",
        }
        return npy_response(found.samples, headers, timing)
    # Constructed, not validated: the lists come from an array, and walking them costs more than sampling.
    body = SampleAnswer.model_construct(
        samples=found.samples.tolist(),
        confidence=None if found.confidence is None else found.confidence.tolist(),
        unseen=None if found.unseen is None else found.unseen.tolist(),
        ways=None if found.ways is None else found.ways.tolist(),
        shortfall=found.shortfall,
        acceptance=found.acceptance,
        seed=str(query.seed),
        timing_ms=timing,
        **about(served, novelty, warnings),
    )
    return Response(body.model_dump_json(), media_type="application/json")


def prepared_picture(store: ModelStore, bundle: Bundle, image: bytes, job: Job) -> Prepared:
    """A picture as a bundle takes it; one that is not known is paid for, and read in parts.

    Raises:
        InputError: not a picture that is accepted.
        BundleError: the encoder fails.
        ClientDisconnect: the client has gone away.
    """
    values = prod(bundle.spec.world.sensor.picture_shape)
    return store.pictures.get(
        bundle, image, lambda pixels: job.spend(rows_of(pixels=pixels, values=values)), job.check_cancelled
    )


def npy_response(array: NDArray[Any], headers: dict[str, str], timing: BaseModel) -> Response:
    """An array as a float32 ``.npy``, the rest in headers."""
    found = np.ascontiguousarray(array, dtype="<f4")
    spent = ", ".join(f"{name};dur={value:.3f}" for name, value in timing.model_dump().items())
    content = npy_head(found.shape) + found.tobytes()
    return Response(content, headers=headers | {"Server-Timing": spent}, media_type=NPY)


@lru_cache(maxsize=64)
def npy_head(shape: tuple[int, ...]) -> bytes:
    """What stands before the numbers in the ``.npy`` of a float32 array in C order."""
    buffer = io.BytesIO()
    described = {"descr": "<f4", "fortran_order": False, "shape": shape}
    np.lib.format.write_array_header_1_0(buffer, described)
    return buffer.getvalue()


def model_headers(
    served: ServedModel, novelty: float | None, warnings: Sequence[PictureWarning]
) -> dict[str, str]:
    """What a ``.npy`` cannot hold of the model that answered and of the picture."""
    headers = {
        "X-Model-Name": served.name,
        "X-Model-Version": str(served.version),
        "X-Model-Digest": served.bundle.digest,
        "X-Robot": served.bundle.robot,
        "X-Alias-Confirmed": "true" if served.confirmed else "false",
        "X-Joint-Space": json.dumps(served.bundle.spec.joint_space, separators=(",", ":")),
        "X-Warnings": _warnings_text(warnings),
    }
    return headers if novelty is None else headers | {"X-Novelty": f"{novelty:.6g}"}


def _warnings_text(warnings: Sequence[PictureWarning]) -> str:
    """ASCII JSON of at most :data:`MAX_WARNINGS` characters: the last ones lose their words."""
    rows = [one.model_dump() for one in warnings]
    for one in reversed(rows):
        if len(json.dumps(rows)) <= MAX_WARNINGS:
            break
        one["message"] = ""
    return json.dumps(rows, separators=(",", ":"))
