"""``/docs``, ``/guide`` and the OpenAPI document."""

import base64
import hashlib
import re
from importlib.resources import files
from pathlib import Path
from typing import Any

from fastapi import FastAPI
from fastapi.openapi.docs import get_swagger_ui_html
from fastapi.openapi.utils import get_openapi
from fastapi.responses import HTMLResponse, RedirectResponse, Response
from fastapi.staticfiles import StaticFiles
from pydantic.json_schema import models_json_schema
from starlette.exceptions import HTTPException
from starlette.types import Scope

from cspace_client.wire import OutcomesRequest, Problem
from inference_api.limits import HEALTH
from inference_api.problems import NOT_FOUND, RequestError
from inference_api.request_body import FORM
from inference_api.scene import (
    BeliefRequest,
    DoctorRequest,
    PlanRequest,
    SampleRequest,
    SceneFields,
    ValidityRequest,
)

PAGE = "/guide"
_INLINE_SCRIPT = re.compile(rb"<script>(.*?)</script>", re.DOTALL)
# Style attributes and small pictures are parts of Swagger UI and of the site's theme.
_POLICY = (
    "default-src 'none'; script-src 'self'{scripts}; style-src 'self' 'unsafe-inline'; img-src 'self' data:; "
    "connect-src 'self'; base-uri 'none'; form-action 'self'; frame-ancestors 'none'"
)
# Which FastAPI does not see in the signatures of routes.
_UNSEEN = (
    Problem,
    OutcomesRequest,
    SampleRequest,
    ValidityRequest,
    PlanRequest,
    BeliefRequest,
    DoctorRequest,
)


def document(app: FastAPI, default_model: str) -> dict[str, Any]:
    """The OpenAPI document, made once: FastAPI's, with models and keys that it cannot see.

    Args:
        app: whose routes are described.
        default_model: that answers requests which name none.
    """
    if app.openapi_schema is None:
        made = get_openapi(
            title=app.title, version=app.version, description=app.description, routes=app.routes
        )
        components = made.setdefault("components", {})
        components["securitySchemes"] = {"key": {"type": "http", "scheme": "bearer"}}
        # Either none or a key, for whoever runs the server decides.
        made["security"] = [{}, {"key": []}]
        for path in HEALTH:
            made["paths"][path]["get"]["security"] = []
        _, found = models_json_schema(
            [(kind, "validation") for kind in _UNSEEN], ref_template="#/components/schemas/{model}"
        )
        components["schemas"] = components.get("schemas", {}) | found["$defs"]
        for kind in SceneFields.__subclasses__():
            body = made["paths"][f"/{kind.__name__.removesuffix('Request').lower()}"]["post"]["requestBody"]
            form = body["content"][FORM]["schema"]
            for schema in (form, components["schemas"][kind.__name__]):
                schema["properties"]["model"]["default"] = default_model
        app.openapi_schema = made
    return app.openapi_schema


def add_docs_page(app: FastAPI) -> None:
    """Serve ``/docs`` from files of the server itself."""
    page = get_swagger_ui_html(
        openapi_url="openapi.json",
        title=f"{app.title} API",
        swagger_js_url="docs/assets/swagger-ui-bundle.js",
        swagger_css_url="docs/assets/swagger-ui.css",
        swagger_favicon_url="docs/assets/favicon.png",
        # The default asks a validator on the internet what it thinks of the document.
        swagger_ui_parameters={"validatorUrl": None},
    )
    hashes = (
        base64.b64encode(hashlib.sha256(script).digest()).decode()
        for script in _INLINE_SCRIPT.findall(page.body)
    )
    page.headers["Content-Security-Policy"] = _POLICY.format(
        scripts="".join(f" 'sha256-{one}'" for one in hashes)
    )

    @app.get("/docs", include_in_schema=False)
    def docs() -> HTMLResponse:
        return page

    app.mount("/docs/assets", StaticFiles(directory=Path(str(files("fastapi_offline") / "static"))))


def add_guide(app: FastAPI, folder: Path) -> None:
    """Serve ``/guide`` and all below it; the folder of the site may come and go while the app runs."""

    @app.get(PAGE, include_in_schema=False)
    def guide() -> RedirectResponse:
        # Relative, for a proxy may have put the API below a path of its own.
        return RedirectResponse("guide/")

    app.mount(PAGE, _GuideFiles(folder), name="guide")


class _GuideFiles(StaticFiles):
    def __init__(self, folder: Path) -> None:
        super().__init__(directory=folder, html=True, check_dir=False)
        self._first_page = folder / "index.html"
        # A folder that is not there is an answer, not an error of the server.
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
        answer.headers["Content-Security-Policy"] = _POLICY.format(scripts="")
        return answer
