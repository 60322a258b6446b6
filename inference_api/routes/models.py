"""``GET /models``, ``/health`` and ``/metrics``: what can be asked, and how the server is."""

from functools import lru_cache, partial
from typing import Any

from fastapi import APIRouter, Request
from fastapi.responses import PlainTextResponse, Response

from cspace.errors import InputError, ScenarioError
from cspace.query import is_digest
from cspace.strict_json import parse_json
from cspace.world import World
from cspace.worlds import read_world, robot_digest
from inference_api.limits import client_of
from inference_api.models.served import PRETRAINED_VERSION, ServedModel
from inference_api.models.store import ModelStore
from inference_api.problem_types import (
    GUARD_PROBLEMS,
    INVALID_VALUE,
    NO_MODEL,
    STARTING,
    UNAUTHORIZED,
    ModelNotReadyError,
)
from inference_api.requests import Service, Serving, problem_responses
from inference_api.scheduler import STUCK_S
from inference_api.schemas import ListedModel, Live, ModelList, Ready, joint_space_info, model_info
from inference_api.telemetry import CONTENT_TYPE
from services.names import MAX_WORLD, TAG_ROBOT, TAG_WORLD
from services.registry.entities import ModelReference, ModelVersion, is_model_name

router = APIRouter()


@router.get(
    "/models",
    summary="Models that requests can name",
    responses=problem_responses(*GUARD_PROBLEMS, INVALID_VALUE),
)
async def models(request: Request, service: Serving, name: str | None = None) -> ModelList:
    """Versions of the model of this name, newest first, and the shipped models.

    Without a name: all versions of the default model, and those of other models that have an alias.
    """
    return await service.lookups.run(partial(_listed, service.store, name), client_of(request.scope))


@router.get(
    "/metrics",
    summary="What Prometheus scrapes",
    response_class=PlainTextResponse,
    responses=problem_responses(UNAUTHORIZED),
)
async def metrics(service: Serving) -> Response:
    """Requests, failures, latencies, acceptance, reloads and the model in service, as text."""
    return Response(service.metrics.render(), media_type=CONTENT_TYPE)


@router.get("/health/live", summary="Whether the process answers")
async def live() -> Live:
    """Always ok; says nothing about models."""
    return Live()


@router.get(
    "/health/ready",
    summary="Whether the server can answer",
    responses=problem_responses(NO_MODEL, STARTING),
)
async def ready(service: Serving) -> Ready:
    """The model that answers requests that name none; 503 at the start, without one, or while none ends."""
    served, store = default_model(service), service.store
    return Ready(registry=store.registry_state, successor=store.successor, model=model_info(served))


def default_model(service: Service) -> ServedModel:
    """The model that answers requests that name none.

    Raises:
        RequestError: the search of plans is not loaded yet.
        ModelNotReadyError: there is none, or no request comes to its end.
    """
    store = service.store
    if store.planner.state == "loading":
        store.planner.require()
    served = store.resolve_now(ModelReference(store.model_name))
    if served is None or service.scheduler.is_stuck:
        raise ModelNotReadyError(
            "the server cannot answer yet",
            expected=f"a model, and requests that are computed within {STUCK_S:g} s",
            got="no model" if served is None else "requests that do not end",
            remedy="ask again in some seconds; if that does not help, start the server again",
        )
    return served


def _listed(store: ModelStore, name: str | None) -> ModelList:
    """Versions of a model, newest first; None for what is registered at all. And the shipped models."""
    if name is not None and not is_model_name(name):
        raise InputError("name is wrong", expected="a registered model's name", got=repr(name)[:200])
    served = store.default
    default = None if served is None else (served.name, served.version)
    found = [
        ListedModel(
            reference=str(version),
            name=version.name,
            version=version.number,
            aliases=list(version.aliases),
            run_id=version.run_id or None,
            digest=version.digest,
            loaded=(bundle := store.loaded(version)) is not None,
            default=(version.name, version.number) == default,
            **_described(
                _registered_world(version) if bundle is None else bundle.spec.world,
                version.tags.get(TAG_ROBOT),
            ),
        )
        for version in (store.listed() if name is None else store.versions(name))
    ]
    found += [
        ListedModel(
            reference=shipped.name,
            name=shipped.name,
            version=PRETRAINED_VERSION,
            aliases=[],
            run_id=None,
            digest=shipped.digest,
            loaded=shipped.loaded is not None,
            default=default == (shipped.name, PRETRAINED_VERSION),
            **_described(shipped.spec.world),
        )
        for shipped in store.shipped
    ]
    return ModelList(default=store.model_name, registry=store.registry_state, models=found)


def _described(world: World | None, robot: str | None = None) -> dict[str, Any]:
    if world is None:
        return {"robot": robot if robot and is_digest(robot) else None, "world": None, "joint_space": None}
    space = joint_space_info(world.space.to_dict())
    return {"robot": robot_digest(world), "world": world.to_dict(), "joint_space": space}


def _registered_world(version: ModelVersion) -> World | None:
    return _read_world(version.tags.get(TAG_WORLD, ""))


@lru_cache(maxsize=1024)
def _read_world(tag: str) -> World | None:
    """What registration wrote of a version's world, or somebody else, who may write what he likes."""
    try:
        return read_world(parse_json(tag.encode())) if 0 < len(tag) <= MAX_WORLD else None
    except (ScenarioError, ValueError, RecursionError):
        return None
