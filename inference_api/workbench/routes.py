"""The page at ``/``; the routes that it alone uses are not part of the contract."""

from importlib.util import find_spec
from pathlib import Path

from fastapi import FastAPI
from fastapi.responses import FileResponse, Response
from pydantic import BaseModel
from starlette.staticfiles import StaticFiles
from starlette.types import Scope

from cspace.errors import ConfigError
from inference_api.limits import WORKBENCH_FILES
from inference_api.workbench import planar

# What compiled checks and drawn scenes need, as the extra ``workbench`` has it.
_PACKAGES = ("numba", "scipy", "matplotlib")
FOLDER = Path(__file__).parent / "files"
# No inline script and no inline style; pictures are shown from their base64.
POLICY = (
    "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self' data:; connect-src 'self'; "
    "base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
)


class PageFiles(StaticFiles):
    """Files that a browser keeps and revalidates, so that an upgrade is seen at once."""

    async def get_response(self, path: str, scope: Scope) -> Response:
        """The file, or that it has not changed."""
        response = await super().get_response(path, scope)
        response.headers["Cache-Control"] = "no-cache"
        return response


class About(BaseModel):
    """What the page can count on."""

    version: str
    truth: bool


def add_workbench(app: FastAPI, *, truth: bool) -> None:
    """Serves the page; with ``truth`` also pictures of scenes and their ground truth."""

    @app.get("/", include_in_schema=False)
    async def workbench() -> FileResponse:
        headers = {"Content-Security-Policy": POLICY}
        return FileResponse(FOLDER / "index.html", media_type="text/html", headers=headers)

    app.mount(WORKBENCH_FILES, PageFiles(directory=FOLDER), name="workbench-files")

    @app.get("/workbench/about", include_in_schema=False)
    async def about() -> About:
        return About(version=app.version, truth=truth)

    if not truth:
        return
    if missing := [name for name in _PACKAGES if find_spec(name) is None]:
        raise ConfigError(
            "the workbench cannot compute the ground truth",
            expected="the packages of the extra workbench",
            got=f"no {', '.join(missing)}",
            remedy="pip install .[workbench], or unset CSPACE_API_WORKBENCH",
        )
    app.include_router(planar.router)
