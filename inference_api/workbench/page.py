"""``/`` and the files of its page, under a policy that lets the page load nothing but them."""

from pathlib import Path

from fastapi import FastAPI
from fastapi.responses import FileResponse, Response
from starlette.staticfiles import StaticFiles
from starlette.types import Scope

from inference_api.page_names import WORKBENCH_FILES

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


def add_page(app: FastAPI) -> None:
    """Serve ``/`` and the files that it needs."""

    @app.get("/", include_in_schema=False)
    async def workbench() -> FileResponse:
        return FileResponse(
            FOLDER / "index.html", media_type="text/html", headers={"Content-Security-Policy": POLICY}
        )

    app.mount(WORKBENCH_FILES, PageFiles(directory=FOLDER), name="workbench-files")
