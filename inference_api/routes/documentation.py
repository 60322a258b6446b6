"""``/docs`` and ``/guide``: documentation from files of the server itself."""

import base64
import hashlib
import re
from importlib.resources import files
from pathlib import Path

from fastapi import FastAPI
from fastapi.openapi.docs import get_swagger_ui_html
from fastapi.responses import HTMLResponse, RedirectResponse, Response
from fastapi.staticfiles import StaticFiles
from starlette.exceptions import HTTPException
from starlette.types import Scope

from inference_api.problem_types import NOT_FOUND, RequestError

_ASSETS = "/docs/assets"
_INLINE_SCRIPT = re.compile(rb"<script>(.*?)</script>", re.DOTALL)
PAGE = "/guide"
# Scripts and search index are files of the site. Drawings of the theme have style attributes.
POLICY = (
    "default-src 'none'; script-src 'self'; style-src 'self' 'unsafe-inline'; img-src 'self' data:; "
    "connect-src 'self'; base-uri 'none'; form-action 'self'; frame-ancestors 'none'"
)


def add_docs_page(app: FastAPI) -> None:
    """Serve ``/docs`` and the assets that it needs."""
    folder = Path(str(files("fastapi_offline") / "static"))
    page = get_swagger_ui_html(
        openapi_url="openapi.json",
        title=f"{app.title} API",
        swagger_js_url="docs/assets/swagger-ui-bundle.js",
        swagger_css_url="docs/assets/swagger-ui.css",
        swagger_favicon_url="docs/assets/favicon.png",
        # The default asks a validator on the internet what it thinks of the document.
        swagger_ui_parameters={"validatorUrl": None},
    )

    page.headers["Content-Security-Policy"] = policy(bytes(page.body))

    @app.get("/docs", include_in_schema=False)
    def docs() -> HTMLResponse:
        return page

    app.mount(_ASSETS, StaticFiles(directory=folder), name="docs-assets")


def policy(html: bytes) -> str:
    """The content security policy of a page: files of the server, and its inline scripts as they are now."""
    hashes = [
        f"'sha256-{base64.b64encode(hashlib.sha256(script).digest()).decode()}'"
        for script in _INLINE_SCRIPT.findall(html)
    ]
    return "; ".join(
        (
            "default-src 'none'",
            f"script-src 'self' {' '.join(hashes)}".rstrip(),
            # Swagger UI writes style attributes and pictures of its own into the page.
            "style-src 'self' 'unsafe-inline'",
            "img-src 'self' data:",
            "connect-src 'self'",
            "base-uri 'none'",
            "form-action 'none'",
            "frame-ancestors 'none'",
        )
    )


def add_guide(app: FastAPI, folder: Path) -> None:
    """Serve ``/guide`` and all below it.

    Args:
        app: that serves it.
        folder: of the built site; it may come and go while the app runs.
    """

    @app.get(PAGE, include_in_schema=False)
    def guide() -> RedirectResponse:
        # Relative, for a proxy may have put the API below a path of its own.
        return RedirectResponse("guide/")

    app.mount(PAGE, GuideFiles(folder), name="guide")


class GuideFiles(StaticFiles):
    """The site's files, with the policy that its pages need.

    Args:
        folder: of the built site.
    """

    def __init__(self, folder: Path) -> None:
        super().__init__(directory=folder, html=True, check_dir=False)
        self._first_page = folder / "index.html"
        # A folder that is not there is told by an answer, not by an error of the server.
        self.config_checked = True

    async def get_response(self, path: str, scope: Scope) -> Response:
        """A file, or the reason why there is none."""
        try:
            answer = await super().get_response(path, scope)
        except HTTPException as error:
            if error.status_code == NOT_FOUND.status and not self._first_page.is_file():
                raise RequestError(
                    NOT_FOUND,
                    "the guide is not built here",
                    remedy="run make docs beside the server, or have its CSPACE_API_GUIDE name a built one",
                ) from error
            raise
        answer.headers["Content-Security-Policy"] = POLICY
        return answer
