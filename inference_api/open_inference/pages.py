"""The pages of the Open Inference Protocol v2 over HTTP, with its extension for binary tensors.

The protocol is KServe's and Triton's; its clients ask for samples here as they would ask any model.
"""

from functools import partial
from typing import Any

from fastapi import APIRouter, FastAPI, Request
from fastapi.responses import Response

from cspace.bundle.spec import WAYS
from inference_api.guards.rate import client_of
from inference_api.models.served import PRETRAINED_VERSION, ServedModel
from inference_api.models.store import ModelStore
from inference_api.open_inference.picture_tensors import inputs_of
from inference_api.open_inference.protocol_errors import PREFIX, ProtocolErrors
from inference_api.open_inference.tensor_sampling import read_inference, reference_of
from inference_api.open_inference.tensor_schemas import (
    InferenceAnswer,
    ModelMetadata,
    ModelReady,
    ProtocolError,
    ServerLive,
    ServerMetadata,
    ServerReady,
    TensorMetadata,
)
from inference_api.open_inference.tensor_scoring import configurations_input
from inference_api.open_inference.tensors import JSON_LENGTH
from inference_api.pages.dependencies import Room, Store, Turn, room_of, store_of, turns_of
from inference_api.pages.exchange import respond
from inference_api.pages.health import default_model
from inference_api.problems import UNSUPPORTED_MEDIA_TYPE, RequestError
from services.registry.references import ModelReference, is_shipped

MEDIA_TYPES = ("application/json", "application/octet-stream")
PLATFORM = "onnx_onnxv1"
_BINARY_BODY = {"schema": {"type": "string", "format": "binary"}}
_REQUEST = {
    "requestBody": {
        "required": True,
        "content": {
            "application/json": {"schema": {"$ref": "#/components/schemas/InferenceRequest"}},
            "application/octet-stream": _BINARY_BODY,
        },
    },
    "parameters": [
        {
            "name": JSON_LENGTH,
            "in": "header",
            "required": False,
            "description": "Length of the JSON object in bytes, when binary tensors follow it.",
            "schema": {"type": "integer", "minimum": 0},
        }
    ],
}


def _errors(*statuses: int) -> dict[int | str, dict[str, Any]]:
    # With a default, for FastAPI would put its own 422 there, which these pages never answer.
    described = {"model": ProtocolError, "description": "An error."}
    return {**dict.fromkeys(statuses, described), "default": described}


_MODEL_ERRORS = _errors(400, 401, 403, 404, 421, 429, 500, 503)
_ANSWERS: dict[int | str, dict[str, Any]] = {
    200: {
        "model": InferenceAnswer,
        "content": {"application/octet-stream": _BINARY_BODY},
        "headers": {
            JSON_LENGTH: {
                "description": "Length of the JSON object in bytes, when binary tensors follow it.",
                "schema": {"type": "integer"},
            }
        },
    },
    **_errors(400, 401, 403, 404, 408, 409, 413, 415, 421, 429, 500, 503),
}

router = APIRouter(prefix=PREFIX, tags=["Open Inference Protocol"])


def add_open_inference(app: FastAPI) -> None:
    """Serve the protocol's pages; to be called after every other middleware, so that its errors are seen."""
    app.include_router(router)
    app.add_middleware(ProtocolErrors)


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


@router.get("/health/ready", summary="Whether samples can be asked for", responses=_errors(503))
async def ready(store: Store, turns: Turn) -> ServerReady:
    """503 while no model answers by default."""
    default_model(store, turns)
    return ServerReady()


@router.get("/models/{model}", summary="A model's tensors", responses=_MODEL_ERRORS)
async def metadata(request: Request, store: Store, room: Room, model: str) -> ModelMetadata:
    """Names, types and shapes; the outputs are given as for one picture and without configurations."""
    return await room.run(partial(_describe, store, model, reference_of(model)), client_of(request.scope))


@router.get("/models/{model}/versions/{version}", summary="A version's tensors", responses=_MODEL_ERRORS)
async def version_metadata(
    request: Request, store: Store, room: Room, model: str, version: str
) -> ModelMetadata:
    """As for a model; the shipped model has the version 0."""
    reference = reference_of(model, version)
    return await room.run(partial(_describe, store, model, reference), client_of(request.scope))


@router.get("/models/{model}/ready", summary="Whether a model can be asked", responses=_MODEL_ERRORS)
async def model_ready(request: Request, store: Store, room: Room, model: str) -> ModelReady:
    """Loads the model if it is not in memory."""
    await room.run(partial(store.resolve, reference_of(model)), client_of(request.scope))
    return ModelReady(name=model)


@router.get(
    "/models/{model}/versions/{version}/ready",
    summary="Whether a version can be asked",
    responses=_MODEL_ERRORS,
)
async def version_ready(request: Request, store: Store, room: Room, model: str, version: str) -> ModelReady:
    """Loads the version if it is not in memory."""
    await room.run(partial(store.resolve, reference_of(model, version)), client_of(request.scope))
    return ModelReady(name=model)


@router.post(
    "/models/{model}/infer", summary="Samples from a model", openapi_extra=_REQUEST, responses=_ANSWERS
)
async def infer(request: Request, model: str) -> Response:
    """The same samples as `POST /sample` gives for the same picture, seed, parameters and model.

    With the input `configurations` the same confidences as `POST /validity` gives for them.
    """
    return await _infer(request, reference_of(model))


@router.post(
    "/models/{model}/versions/{version}/infer",
    summary="Samples from a version",
    openapi_extra=_REQUEST,
    responses=_ANSWERS,
)
async def version_infer(request: Request, model: str, version: str) -> Response:
    """As for a model; the shipped model has the version 0."""
    return await _infer(request, reference_of(model, version))


async def _infer(request: Request, reference: ModelReference) -> Response:
    _check_media_type(request)
    store, body = store_of(request), await request.body()
    ask = partial(read_inference, store, reference, body, request.headers.get(JSON_LENGTH))
    return await respond(request, store, turns_of(request), room_of(request), ask)


def _describe(store: ModelStore, name: str, reference: ModelReference) -> ModelMetadata:
    served = store.resolve(reference)
    spec = served.bundle.spec
    scores = [_tensor("confidence", "FP32", -1)] if served.bundle.has_validity else []
    asked_about = [configurations_input(spec.dim)] if served.bundle.has_validity else []
    told = [_tensor("novelty", "FP32", -1)] if spec.novelty_quantiles is not None else []
    return ModelMetadata(
        name=name,
        versions=_versions(store, served),
        platform=PLATFORM,
        inputs=inputs_of((*spec.world.tensors, *asked_about)),
        outputs=[
            _tensor("samples", "FP32", -1, spec.dim),
            *scores,
            *([_tensor("unseen", "FP32", -1)] if served.bundle.tells_unseen else []),
            *([_tensor("ways", "INT64", -1)] if spec.model_kind == WAYS else []),
            _tensor("shortfall", "INT32", -1),
            *told,
            _tensor("seed", "UINT64", -1),
        ],
    )


def _check_media_type(request: Request) -> None:
    coding = request.headers.get("content-encoding", "identity").strip().lower()
    media_type = request.headers.get("content-type", "").partition(";")[0].strip().lower()
    # The protocol's own clients send none.
    if coding != "identity" or media_type not in ("", *MEDIA_TYPES):
        raise RequestError(
            UNSUPPORTED_MEDIA_TYPE,
            "the body's media type is not supported",
            expected=f"{' or '.join(MEDIA_TYPES)}, without a content coding",
            got=f"{media_type or 'no content type'}, {coding}"[:200],
        )


def _versions(store: ModelStore, served: ServedModel) -> list[str]:
    if is_shipped(served.name):
        return [str(PRETRAINED_VERSION)]
    if served.name != store.model_name:
        return [str(served.version)]
    listed = {version.number for version in store.versions(served.name)} | {served.version}
    return [str(number) for number in sorted(listed)]


def _tensor(name: str, datatype: str, *shape: int) -> TensorMetadata:
    return TensorMetadata(name=name, datatype=datatype, shape=list(shape))
