"""The pages that the workbench asks: what this server can do, stories of models, the truth where it is on."""

from collections.abc import Callable
from functools import partial
from importlib.util import find_spec
from typing import TypeVar

from fastapi import FastAPI, Request
from fastapi.responses import Response
from pydantic import BaseModel

from cspace.errors import ConfigError
from inference_api.bodies.bounded_json import MAX_TENSOR_MARKS, parse_json
from inference_api.bodies.request_body import RawFields, read_fields
from inference_api.guards.rate import client_of
from inference_api.pages.dependencies import Room, Store, room_of, store_of, turns_of
from inference_api.pages.exchange import Question, respond
from inference_api.pages.validation import validate_fields
from inference_api.problems import UNSUPPORTED_MEDIA_TYPE, RequestError
from inference_api.turns.costs import rows_of
from inference_api.turns.turns import Turn
from inference_api.workbench.models import Stories, stories
from inference_api.workbench.page import add_page
from inference_api.workbench.scene_file import FileQuestion, FileRequest
from inference_api.workbench.search import SearchQuestion
from inference_api.workbench.search_schemas import SearchRequest
from inference_api.workbench.truth import SceneQuestion, TruthQuestion
from inference_api.workbench.truth_schemas import SceneRequest, TruthRequest
from services.registry.references import ModelReference

# What compiled checks, drawn scenes and scene files need, as the extra ``workbench`` has it.
_PACKAGES = ("numba", "scipy", "matplotlib", "jsonschema", "yaml")

Asked = TypeVar("Asked", FileRequest, SceneRequest, SearchRequest, TruthRequest)


class About(BaseModel):
    """What the page can count on.

    Args:
        version: of the server.
        truth: whether the truth can be asked for.
        plans: whether ways can.
        mlflow: where browsers find MLflow.
    """

    version: str
    truth: bool
    plans: bool
    mlflow: str | None


def add_workbench(app: FastAPI, *, truth: bool, mlflow_pages: str | None) -> None:
    """Serve the page, and what it asks.

    Args:
        app: whose.
        truth: whether the truth may be asked for.
        mlflow_pages: where browsers find MLflow.

    Raises:
        ConfigError: the truth is wanted, and its packages are not there.
    """
    missing = [name for name in _PACKAGES if truth and not _is_installed(name)]
    if missing:
        raise ConfigError(
            "the workbench cannot tell the truth",
            expected="the packages of the extra workbench",
            got=f"no {', '.join(missing)}",
            remedy="pip install .[workbench], or leave CSPACE_API_WORKBENCH and --workbench out",
        )
    add_page(app)
    about = About(version=app.version, truth=truth, plans=_is_installed("numba"), mlflow=mlflow_pages)

    @app.get("/workbench/about", include_in_schema=False)
    async def told() -> About:
        return about

    @app.get("/workbench/models", include_in_schema=False)
    async def models(request: Request, store: Store, room: Room, name: str | None = None) -> Stories:
        return await room.run(partial(stories, store, name, mlflow_pages), client_of(request.scope))

    if truth:
        app.post("/workbench/scene-file", include_in_schema=False)(_scene_file)
        app.post("/workbench/scene", include_in_schema=False)(_scene)
        app.post("/workbench/search", include_in_schema=False)(_search)
        app.post("/workbench/truth", include_in_schema=False)(_truth)


def _is_installed(name: str) -> bool:
    try:
        return find_spec(name) is not None
    except ImportError:
        return False


async def _scene(request: Request) -> Response:
    return await _ask(request, SceneRequest, SceneQuestion)


async def _scene_file(request: Request) -> Response:
    return await _ask(request, FileRequest, FileQuestion)


async def _search(request: Request) -> Response:
    return await _ask(request, SearchRequest, SearchQuestion)


async def _truth(request: Request) -> Response:
    return await _ask(request, TruthRequest, TruthQuestion)


async def _ask(
    request: Request, kind: type[Asked], question: Callable[[Asked, ModelReference], Question]
) -> Response:
    fields = await read_fields(request)
    store = store_of(request)

    def read(turn: Turn) -> Question:
        turn.spend(rows_of(json_bytes=fields.json_bytes))
        asked = validate_fields(kind, parse_json(_json(fields), MAX_TENSOR_MARKS))
        return question(asked, ModelReference.parse(asked.model or store.model_name))

    return await respond(request, store, turns_of(request), room_of(request), read)


def _json(fields: RawFields) -> bytes:
    if fields.boundary is not None:
        raise RequestError(
            UNSUPPORTED_MEDIA_TYPE, "forms are not read here", expected="application/json", got="a form"
        )
    return fields.body
