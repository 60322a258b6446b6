"""``/docs`` without the internet: Swagger UI from an installed package instead of a content network."""

import base64
import hashlib
import re
from importlib.resources import files
from pathlib import Path

from fastapi import FastAPI
from fastapi.openapi.docs import get_swagger_ui_html
from fastapi.responses import HTMLResponse
from fastapi.staticfiles import StaticFiles

_ASSETS = "/docs/assets"
_INLINE_SCRIPT = re.compile(rb"<script>(.*?)</script>", re.DOTALL)


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
