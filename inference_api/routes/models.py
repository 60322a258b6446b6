"""``GET /models``, ``/health`` and ``/metrics``: what can be asked, and how the server is."""

from functools import lru_cache
from typing import Any, Literal

from fastapi import APIRouter
from fastapi.responses import PlainTextResponse, Response
from prometheus_client.exposition import CONTENT_TYPE_PLAIN_0_0_4
from pydantic import Field

from cspace.errors import InputError, ScenarioError
from cspace.files import parse_json
from cspace.query import is_digest
from cspace.world import World
from cspace.worlds import read_world, robot_digest
from cspace_client.wire import Answer, JointSpaceInfo, ModelInfo
from inference_api.kernels import Kernels
from inference_api.problems import ModelNotReadyError
from inference_api.scene import model_info
from inference_api.served_models import PRETRAINED_VERSION, Models, ModelStore, ServedModel, Shipped
from inference_api.telemetry import metrics_text
from services.names import MAX_WORLD, TAG_ROBOT, TAG_WORLD
from services.registry.entities import ModelVersion, is_model_name

router = APIRouter()


class ListedModel(Answer):
    """A model that a request can name."""

    reference: str = Field(description="What to write into `model`.")
    name: str
    version: int
    aliases: list[str]
    run_id: str | None
    digest: str
    loaded: bool = Field(description="Whether it is in memory.")
    default: bool = Field(description="Whether it answers requests that name no model.")
    robot: str | None = Field(description="SHA-256 of the robot; null where it is not known before loading.")
    world: dict[str, Any] | None = Field(description="Robot and camera; null if too long.")
    joint_space: JointSpaceInfo | None = Field(description="As in an answer; null as `world` is.")


class ModelsAnswer(Answer):
    """The models that requests can name."""

    default: str
    registry: Literal["none", "reachable", "unreachable"]
    models: list[ListedModel]


class Live(Answer):
    """The process answers."""

    status: Literal["live"] = "live"


class Ready(Answer):
    """The default model answers."""

    status: Literal["ready"] = "ready"
    registry: Literal["none", "reachable", "unreachable"]
    successor: Literal["none", "pending", "refused"] = Field(description="A champion not served yet.")
    model: ModelInfo


@router.get(
    "/models",
    summary="Models that requests can name",
)
def models(store: Models, name: str | None = None) -> ModelsAnswer:
    """Versions of the model of this name, newest first, and the shipped models.

    Without a name: all versions of the default model, and those of other models that have an alias.
    """
    if name is not None and not is_model_name(name):
        raise InputError("name is wrong", expected="a registered model's name", got=repr(name)[:200])
    default = store.default
    registered = [_registered(store, one, default) for one in store.listing(name)]
    return ModelsAnswer(
        default=store.model_name,
        registry=store.registry_state,
        models=[*registered, *(_shipped(one, default) for one in store.shipped)],
    )


@router.get(
    "/metrics",
    summary="What Prometheus scrapes",
    response_class=PlainTextResponse,
)
def metrics(store: Models) -> Response:
    """Requests, failures, latencies, reloads and the model in service, as text."""
    return Response(metrics_text(store.default), media_type=CONTENT_TYPE_PLAIN_0_0_4)


# Asynchronous, so that no thread has to be free for them.
@router.get("/health/live", summary="Whether the process answers")
async def live() -> Live:
    """Always ok; says nothing about models."""
    return Live()


@router.get(
    "/health/ready",
    summary="Whether the server can answer",
)
async def ready(store: Models, kernels: Kernels) -> Ready:
    """The model that answers requests that name none; 503 at the start, or without one."""
    kernels.require()
    served = store.default
    if served is None:
        raise ModelNotReadyError(
            "the server cannot answer yet",
            expected="a model",
            got="none",
            remedy="ask again in some seconds; if that does not help, look into the server's log",
        )
    return Ready(registry=store.registry_state, successor=store.successor, model=model_info(served))


def _registered(store: ModelStore, version: ModelVersion, default: ServedModel | None) -> ListedModel:
    bundle = store.loaded(version)
    world = _read_world(version.tags.get(TAG_WORLD, "")) if bundle is None else bundle.spec.world
    robot = version.tags.get(TAG_ROBOT)
    return ListedModel(
        reference=str(version),
        name=version.name,
        version=version.number,
        aliases=list(version.aliases),
        run_id=version.run_id or None,
        digest=version.digest,
        loaded=bundle is not None,
        default=_is(default, version.name, version.number),
        **_described(world, robot if is_digest(robot) else None),
    )


def _shipped(one: Shipped, default: ServedModel | None) -> ListedModel:
    return ListedModel(
        reference=one.name,
        name=one.name,
        version=PRETRAINED_VERSION,
        aliases=[],
        run_id=None,
        digest=one.digest,
        loaded=one.loaded is not None,
        default=_is(default, one.name, PRETRAINED_VERSION),
        **_described(one.spec.world),
    )


def _is(served: ServedModel | None, name: str, version: int) -> bool:
    return served is not None and (served.name, served.version) == (name, version)


def _described(world: World | None, robot: str | None = None) -> dict[str, Any]:
    if world is None:
        return {"robot": robot, "world": None, "joint_space": None}
    space = JointSpaceInfo(**world.space.to_dict())
    return {"robot": robot_digest(world), "world": world.to_dict(), "joint_space": space}


@lru_cache(maxsize=1024)
def _read_world(tag: str) -> World | None:
    """What registration wrote of a version's world, or somebody else, who may write what he likes."""
    try:
        return read_world(parse_json(tag.encode())) if 0 < len(tag) <= MAX_WORLD else None
    except (ScenarioError, ValueError, RecursionError):
        return None
