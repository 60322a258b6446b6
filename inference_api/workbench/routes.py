"""The page at ``/`` and the routes that it asks; the contract does not know of them."""

from collections.abc import Callable
from functools import partial
from importlib.util import find_spec
from pathlib import Path
from typing import TypeVar

from fastapi import FastAPI, Request
from fastapi.responses import FileResponse, Response
from pydantic import BaseModel
from starlette.staticfiles import StaticFiles
from starlette.types import Scope

from cspace.errors import ConfigError
from inference_api.limits import WORKBENCH_FILES, client_of
from inference_api.models.served import ServedModel
from inference_api.requests import Serving
from inference_api.scheduler import Job
from inference_api.workbench import planar
from inference_api.workbench.schemas import (
    FileRequest,
    SceneRequest,
    SearchRequest,
    TruthRequest,
    WorkbenchRequest,
)
from inference_api.workbench.stories import Stories, stories

# What compiled checks, drawn scenes and scene files need, as the extra ``workbench`` has it.
_PACKAGES = ("numba", "scipy", "matplotlib", "yaml")
FOLDER = Path(__file__).parent / "files"
# No inline script and no inline style; pictures that the page draws itself are blobs.
POLICY = (
    "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self' blob:; connect-src 'self'; "
    "base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
)


class PageFiles(StaticFiles):
    """Files that a browser keeps and asks about again, so that an upgrade is seen at once."""

    async def get_response(self, path: str, scope: Scope) -> Response:
        """The file, or that it has not changed."""
        response = await super().get_response(path, scope)
        response.headers["Cache-Control"] = "no-cache"
        return response


class About(BaseModel):
    """What the page can count on.

    Args:
        version: of the server.
        truth: whether it answers with the ground truth.
        plans: whether it plans paths.
        mlflow: where browsers find MLflow.
    """

    version: str
    truth: bool
    plans: bool
    mlflow: str | None


Fields = TypeVar("Fields", bound=WorkbenchRequest)


def add_workbench(app: FastAPI, *, truth: bool, mlflow_pages: str | None) -> None:
    """Serves the page, and what it asks.

    Args:
        app: whose.
        truth: whether to serve the ground truth.
        mlflow_pages: where browsers find MLflow.

    Raises:
        ConfigError: the truth is wanted, and its packages are not there.
    """
    missing = [name for name in _PACKAGES if truth and not _is_installed(name)]
    if missing:
        raise ConfigError(
            "the workbench cannot compute the ground truth",
            expected="the packages of the extra workbench",
            got=f"no {', '.join(missing)}",
            remedy="pip install .[workbench], or leave CSPACE_API_WORKBENCH and --workbench out",
        )

    @app.get("/", include_in_schema=False)
    async def workbench() -> FileResponse:
        return FileResponse(
            FOLDER / "index.html", media_type="text/html", headers={"Content-Security-Policy": POLICY}
        )

    app.mount(WORKBENCH_FILES, PageFiles(directory=FOLDER), name="workbench-files")
    about = About(version=app.version, truth=truth, plans=_is_installed("numba"), mlflow=mlflow_pages)

    @app.get("/workbench/about", include_in_schema=False)
    async def server_info() -> About:
        return about

    @app.get("/workbench/models", include_in_schema=False)
    async def models(request: Request, service: Serving, name: str | None = None) -> Stories:
        return await service.lookups.run(
            partial(stories, service.store, name, mlflow_pages), client_of(request.scope)
        )

    if truth:
        _add(app, "scene-file", FileRequest, planar.scene_file)
        _add(app, "scene", SceneRequest, planar.scene)
        _add(app, "search", SearchRequest, planar.search)
        _add(app, "truth", TruthRequest, planar.truth)


def _add(
    app: FastAPI, name: str, kind: type[Fields], work: Callable[[Fields, ServedModel, Job], Response]
) -> None:
    @app.post(f"/workbench/{name}", include_in_schema=False)
    async def ask(request: Request, service: Serving) -> Response:
        return await service.answer(request, kind, work)


def _is_installed(name: str) -> bool:
    try:
        return find_spec(name) is not None
    except ImportError:
        return False
