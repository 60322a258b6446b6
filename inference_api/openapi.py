"""The OpenAPI document: what FastAPI sees of the pages, and the schemas that it does not."""

from typing import Any

from fastapi import FastAPI
from fastapi.openapi.utils import get_openapi

from inference_api.open_inference.tensor_schemas import InferenceRequest
from inference_api.page_names import HEALTH
from inference_api.pages.schemas import Problem


def document(app: FastAPI) -> dict[str, Any]:
    """The OpenAPI document, made once."""
    if app.openapi_schema is None:
        made = get_openapi(
            title=app.title, version=app.version, description=app.description, routes=app.routes
        )
        template = "#/components/schemas/{model}"
        components = made.setdefault("components", {})
        components["securitySchemes"] = {"key": {"type": "http", "scheme": "bearer"}}
        # Either none or a key, for whoever runs the server decides.
        made["security"] = [{}, {"key": []}]
        for path in HEALTH:
            made["paths"][path]["get"]["security"] = []
        schemas = components.setdefault("schemas", {})
        for unseen in (Problem, InferenceRequest):
            schema = unseen.model_json_schema(ref_template=template)
            schemas.update(schema.pop("$defs", {}))
            schemas[unseen.__name__] = schema
        app.openapi_schema = made
    return app.openapi_schema
