"""The Open Inference Protocol v2 over HTTP, which KServe, Triton and their clients speak.

Errors below ``/v2`` are in its form: :func:`inference_api.problem_types.problem_response` sees to that.
"""

import time
from collections.abc import Mapping
from dataclasses import replace
from functools import partial
from math import prod
from typing import Any

import numpy as np
from fastapi import APIRouter, Request
from fastapi.responses import Response
from numpy.typing import NDArray

from cspace.bundle.samples import fitted, fitted_configurations, require_robot
from cspace.bundle.spec import WAYS
from cspace.errors import InputError
from cspace.query import MAX_SAMPLES, MAX_SEED, SampleQuery
from cspace.world import Examined, TensorInput, World
from inference_api.limits import client_of
from inference_api.models.served import PRETRAINED_VERSION, ServedModel
from inference_api.models.store import ModelStore
from inference_api.problem_types import V2, brief
from inference_api.requests import MAX_FIELD_BYTES, Service, Serving, Work, load_json, media_type_of
from inference_api.routes.models import default_model
from inference_api.scheduler import Job, rows_of
from inference_api.schemas import QueryFields
from inference_api.telemetry import Answered
from inference_api.tensors import (
    JSON_LENGTH,
    InferenceAnswer,
    ModelMetadata,
    ModelReady,
    Parameter,
    ProtocolError,
    ServerLive,
    ServerMetadata,
    ServerReady,
    TensorMetadata,
    inputs_of,
    read_request,
    read_tensors,
    require_fitting,
    split_body,
    write_answer,
)
from services.registry.entities import ModelReference, is_shipped

MEDIA_TYPES = ("application/json", "application/octet-stream")
PLATFORM = "onnx_onnxv1"
CONFIGURATIONS = "configurations"
# Parameters that are JSON arrays in a string.
_ARRAYS = ("epsilon_sigma", "start", "goal")
_FIELDS = ("n", "seed", "min_confidence", "robot", *_ARRAYS)
_ALL_BINARY = "binary_data_output"
_BINARY_BODY = {"schema": {"type": "string", "format": "binary"}}
_LENGTH = {
    "description": "Length of the JSON object in bytes, when binary tensors follow it.",
    "schema": {"type": "integer", "minimum": 0},
}


def _errors(*statuses: int) -> dict[int | str, dict[str, Any]]:
    # With a default, for FastAPI would put its own 422 there, which these routes never answer.
    described = {"model": ProtocolError, "description": "An error."}
    return {**dict.fromkeys(statuses, described), "default": described}


_MODEL_ERRORS = _errors(400, 401, 403, 404, 421, 429, 500, 503)
_INFER: dict[str, Any] = {
    "openapi_extra": {
        "requestBody": {
            "required": True,
            "content": {
                "application/json": {"schema": {"$ref": "#/components/schemas/InferenceRequest"}},
                "application/octet-stream": _BINARY_BODY,
            },
        },
        "parameters": [{"name": JSON_LENGTH, "in": "header", "required": False, **_LENGTH}],
    },
    "responses": {
        200: {
            "model": InferenceAnswer,
            "content": {"application/octet-stream": _BINARY_BODY},
            "headers": {JSON_LENGTH: _LENGTH},
        },
        **_errors(400, 401, 403, 404, 408, 409, 413, 415, 421, 429, 500, 503),
    },
}

router = APIRouter(prefix=V2, tags=["Open Inference Protocol"])


@router.get("", summary="The server")
async def server(request: Request) -> ServerMetadata:
    """Its name, version and extensions."""
    return ServerMetadata(
        name=request.app.title, version=request.app.version, extensions=["binary_tensor_data"]
    )


@router.get("/health/live", summary="Whether the process answers")
async def live() -> ServerLive:
    """Always true; says nothing about models."""
    return ServerLive()


@router.get("/health/ready", summary="Whether the server can answer", responses=_errors(503))
async def ready(service: Serving) -> ServerReady:
    """503 while no model answers by default."""
    default_model(service)
    return ServerReady()


@router.get("/models/{model}", summary="A model's tensors", responses=_MODEL_ERRORS)
async def metadata(request: Request, service: Serving, model: str) -> ModelMetadata:
    """Names, types and shapes; the outputs are given as for one picture and without configurations."""
    describe = partial(_describe, service.store, model, _reference(model))
    return await service.lookups.run(describe, client_of(request.scope))


@router.get("/models/{model}/versions/{version}", summary="A version's tensors", responses=_MODEL_ERRORS)
async def version_metadata(request: Request, service: Serving, model: str, version: str) -> ModelMetadata:
    """As for a model; the shipped model has the version 0."""
    describe = partial(_describe, service.store, model, _reference(model, version))
    return await service.lookups.run(describe, client_of(request.scope))


@router.get("/models/{model}/ready", summary="Whether a model can answer", responses=_MODEL_ERRORS)
async def model_ready(request: Request, service: Serving, model: str) -> ModelReady:
    """Loads the model if it is not in memory."""
    await service.lookups.run(partial(service.store.resolve, _reference(model)), client_of(request.scope))
    return ModelReady(name=model)


@router.get(
    "/models/{model}/versions/{version}/ready",
    summary="Whether a version can answer",
    responses=_MODEL_ERRORS,
)
async def version_ready(request: Request, service: Serving, model: str, version: str) -> ModelReady:
    """Loads the version if it is not in memory."""
    resolve = partial(service.store.resolve, _reference(model, version))
    await service.lookups.run(resolve, client_of(request.scope))
    return ModelReady(name=model)


@router.post("/models/{model}/infer", summary="Samples from a model", **_INFER)
async def infer(request: Request, service: Serving, model: str) -> Response:
    """The same samples as `POST /sample` gives for the same picture, seed, parameters and model.

    With the input `configurations` the same confidences as `POST /validity` gives for them.
    """
    return await _infer(request, service, _reference(model))


@router.post("/models/{model}/versions/{version}/infer", summary="Samples from a version", **_INFER)
async def version_infer(request: Request, service: Serving, model: str, version: str) -> Response:
    """As for a model; the shipped model has the version 0."""
    return await _infer(request, service, _reference(model, version))


async def _infer(request: Request, service: Service, reference: ModelReference) -> Response:
    # The protocol's own clients send none.
    media_type_of(request, *MEDIA_TYPES, "")
    body, length = await request.body(), request.headers.get(JSON_LENGTH)

    def parse(job: Job) -> tuple[ModelReference, Work]:
        return reference, _work(service, body, length, job)

    return await service.respond(request, parse)


def _reference(model: str, version: str | None = None) -> ModelReference:
    """The model that an address names; shipped ones have the version 0."""
    if version is None or (is_shipped(model) and version == "0"):
        return ModelReference.parse(model)
    return ModelReference.parse(f"{model}/{version}")


def _work(service: Service, body: bytes, json_length: str | None, job: Job) -> Work:
    """Parses and validates a request."""
    began = time.perf_counter()
    head, tail = split_body(body, json_length)
    job.spend(rows_of(json_bytes=len(head)))
    request = read_request(head)
    job.check_cancelled()
    tensors = read_tensors(request.inputs, tail)
    job.check_cancelled()
    binary, fields = _parameters(request.parameters)
    scores = CONFIGURATIONS in tensors
    others = sorted(set(fields) - {"robot"}) if scores else []
    if others:
        raise InputError(
            f"{others[0]} does not go with the input {CONFIGURATIONS}",
            expected="no parameter but robot",
            got=others[0],
            remedy=f"leave it out, or ask for samples without the input {CONFIGURATIONS}",
        )
    query = QueryFields.read(fields).query()

    def work(served: ServedModel, job: Job) -> Response:
        if scores:
            arrays, read = _score(service, served, query, tensors, job)
        else:
            arrays, read = _sample(service, served, query, tensors, job, began)
        content, length = write_answer(served, request, arrays, read.findings, binary=binary)
        headers = None if length is None else {JSON_LENGTH: str(length)}
        return Response(content, headers=headers, media_type=MEDIA_TYPES[length is not None])

    return work


def _parameters(parameters: Mapping[str, Parameter]) -> tuple[bool, dict[str, object]]:
    """Whether outputs come as bytes by default, and the fields of a request for samples."""
    unknown = sorted(set(parameters) - {*_FIELDS, _ALL_BINARY})
    if unknown:
        known = f"one of {', '.join((*_FIELDS, _ALL_BINARY))}"
        raise InputError("a parameter is unknown", expected=known, got=repr(unknown[0][:100])[:100])
    fields: dict[str, object] = dict(parameters)
    binary = fields.pop(_ALL_BINARY, False)
    if not isinstance(binary, bool):
        raise InputError(f"{_ALL_BINARY} is wrong", expected="true or false", got=brief(binary))
    for name, value in fields.items():
        if isinstance(value, str) and len(value) > MAX_FIELD_BYTES:
            expected = f"at most {MAX_FIELD_BYTES} characters"
            raise InputError(f"{name} is too long", expected=expected, got=f"{len(value)}")
        if isinstance(value, str) and name in _ARRAYS:
            fields[name] = load_json(name, value.encode("utf-8", errors="replace"))
    return binary, fields


def _read_pictures(world: World, tensors: Mapping[str, NDArray[Any]], job: Job) -> Examined:
    """The pictures (b, ...) that a request's inputs hold, with what is to be said of them."""
    taken = {one.name: one for one in world.tensors}
    needed = {name for name, one in taken.items() if not one.optional}
    if not needed <= set(tensors) <= set(taken):
        named = ", ".join(f"{name} (or without it)" if one.optional else name for name, one in taken.items())
        raise InputError("the inputs are wrong", expected=named, got=", ".join(tensors)[:100])
    sizes: dict[str, int] = {}
    for name, array in tensors.items():
        require_fitting(taken[name], array, sizes)
    pixels = sum(array.size for array in tensors.values())
    job.spend(rows_of(pixels=pixels, values=prod(world.sensor.picture_shape)))
    return world.examine_tensors(tensors, job.check_cancelled)


def _sample(
    service: Service,
    served: ServedModel,
    query: SampleQuery,
    tensors: Mapping[str, NDArray[Any]],
    job: Job,
    began: float,
) -> tuple[dict[str, NDArray[Any]], Examined]:
    """Samples for each picture as it would get them alone, with the seeds seed, seed + 1, ... modulo 2^64.

    Several pictures are cut to the number of samples of the one that has fewest.
    """
    bundle = served.bundle
    query = fitted(query, bundle.spec, has_validity=bundle.has_validity)
    read = _read_pictures(bundle.spec.world, tensors, job)
    if query.n * len(read.images) > MAX_SAMPLES:
        raise InputError(
            "these are too many samples",
            expected=f"n times the number of pictures at most {MAX_SAMPLES}",
            got=f"{query.n} times {len(read.images)}",
            remedy="ask for fewer at a time",
        )
    seeds = [(query.seed + index) % (MAX_SEED + 1) for index in range(len(read.images))]
    prepared, found = [], []
    with job.sampling(bundle.spec, query, len(read.images)) as check_cancelled:
        for image, seed in zip(read.images, seeds, strict=True):
            job.check_cancelled()
            prepared.append(service.store.pictures.of_pixels(bundle, image))
            found.append(
                bundle.answer(
                    prepared[-1].picture, replace(query, seed=seed), check_cancelled=check_cancelled
                )
            )
    count = min(len(one.samples) for one in found)
    arrays = {
        name: np.stack([getattr(one, name)[:count] for one in found])
        for name in ("samples", "confidence", "unseen", "ways")
        if getattr(found[0], name) is not None
    }
    if len(found) == 1:
        arrays = {name: array[0] for name, array in arrays.items()}
    arrays["shortfall"] = np.array([one.shortfall for one in found], dtype=np.int32)
    novelties = [one.picture.novelty for one in prepared if one.picture.novelty is not None]
    if novelties:
        arrays["novelty"] = np.array(novelties, dtype=np.float32)
    arrays["seed"] = np.array(seeds, dtype=np.uint64)
    answered = Answered(
        "samples",
        served,
        n=query.n * len(found),
        seed=seeds[0],
        shortfall=sum(one.shortfall for one in found),
        acceptance=sum(one.acceptance for one in found) / len(found),
        stages_s={
            "encode": 1e-3 * sum(one.encode_ms for one in prepared),
            "generate": 1e-3 * sum(one.generate_ms for one in found),
            "total": time.perf_counter() - began,
        },
    )
    service.metrics.answered(answered)
    return arrays, read


def _score(
    service: Service,
    served: ServedModel,
    query: SampleQuery,
    tensors: Mapping[str, NDArray[Any]],
    job: Job,
) -> tuple[dict[str, NDArray[Any]], Examined]:
    """The confidence of configurations in one picture."""
    bundle, spec = served.bundle, served.bundle.spec
    require_robot(query.robot, spec)
    pictures = dict(tensors)
    given = pictures.pop(CONFIGURATIONS)
    require_fitting(_configurations(spec.dim), given, {})
    configurations = fitted_configurations(given, spec)
    read = _read_pictures(spec.world, pictures, job)
    if len(read.images) != 1:
        raise InputError(
            "configurations are scored in one picture",
            expected="one picture",
            got=f"{len(read.images)}",
            remedy="send a request for each picture",
        )
    job.spend(rows_of(rows=len(configurations)))
    picture = service.store.pictures.of_pixels(bundle, read.images[0]).picture
    confidence, unseen = bundle.predict(picture, configurations, job.check_cancelled)
    service.metrics.answered(Answered("scores", served, n=len(confidence)))
    arrays: dict[str, NDArray[Any]] = {"confidence": confidence}
    arrays |= {} if unseen is None else {"unseen": unseen}
    if picture.novelty is not None:
        arrays["novelty"] = np.array([picture.novelty], dtype=np.float32)
    return arrays, read


def _configurations(dim: int) -> TensorInput:
    return TensorInput(CONFIGURATIONS, "float32", ("n", dim), most=MAX_SAMPLES, optional=True)


def _describe(store: ModelStore, name: str, reference: ModelReference) -> ModelMetadata:
    served = store.resolve(reference)
    bundle, spec = served.bundle, served.bundle.spec
    versions = {PRETRAINED_VERSION if is_shipped(served.name) else served.version}
    if served.name == store.model_name:
        versions |= {version.number for version in store.versions(served.name)}
    scores = bundle.has_validity
    outputs = [
        ("samples", "FP32", [-1, spec.dim], True),
        ("confidence", "FP32", [-1], scores),
        ("unseen", "FP32", [-1], bundle.reports_unseen),
        ("ways", "INT64", [-1], spec.model_kind == WAYS),
        ("shortfall", "INT32", [-1], True),
        ("novelty", "FP32", [-1], spec.novelty_quantiles is not None),
        ("seed", "UINT64", [-1], True),
    ]
    return ModelMetadata(
        name=name,
        versions=[str(number) for number in sorted(versions)],
        platform=PLATFORM,
        inputs=inputs_of((*spec.world.tensors, *([_configurations(spec.dim)] if scores else []))),
        outputs=[
            TensorMetadata(name=name, datatype=datatype, shape=shape)
            for name, datatype, shape, there in outputs
            if there
        ],
    )
