"""The page of the API, made of the OpenAPI document that the server itself gives."""

import json
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from markdown_table import code, table

from inference_api.app import create_app
from inference_api.settings import ApiSettings

INTRODUCTION = """\
# Operations of the API

Made of the document that `GET /openapi.json` gives. What the contract guarantees, with examples, stands in
[the inference API](../api.md); a running server has the same as an interactive page at `/docs`.
"""
METHODS = ("get", "post", "put", "patch", "delete")
PROBLEM = "application/problem+json"


def markdown() -> str:
    """The page."""
    document = create_app(ApiSettings(registry_uri=None, model_cache=Path("unused"))).openapi()
    lines = [INTRODUCTION]
    for path, methods in document["paths"].items():
        for method in METHODS:
            if method in methods:
                lines += list(_operation(f"{method.upper()} {path}", methods[method]))
    lines += ["## Schemas", ""]
    for name, schema in sorted(document["components"]["schemas"].items()):
        lines += [f"### {name}", "", schema.get("description", ""), "", *_properties(schema), ""]
    return "\n".join(lines)


def _operation(name: str, operation: Mapping[str, Any]) -> Iterator[str]:
    yield from (f"## `{name}`", "", f"{operation.get('summary', '')}. {operation.get('description', '')}", "")
    parameters = operation.get("parameters", ())
    if parameters:
        yield from table(
            ("parameter", "where", "type", "meaning"),
            (
                (code(one["name"]), one["in"], _type(one["schema"]), one.get("description", ""))
                for one in parameters
            ),
        )
        yield ""
    body = operation.get("requestBody", {}).get("content", {})
    if body:
        yield from (f"Body: {', '.join(map(code, body))}.", "")
        # All forms of a body have the same fields.
        yield from _properties(next(iter(body.values())).get("schema", {}))
        yield ""
    yield from table(("status", "answer", "as"), _answers(operation["responses"]))
    yield ""


def _answers(responses: Mapping[str, Any]) -> Iterator[tuple[str, ...]]:
    refused = []
    for status, answer in sorted(responses.items()):
        content = answer.get("content", {})
        if set(content) == {PROBLEM}:
            refused.append(status)
            continue
        schema: Mapping[str, Any] = next((one.get("schema", {}) for one in content.values()), {})
        description = answer.get("description", "")
        yield (
            status,
            " ".join(part for part in (description, _type(schema)) if part),
            ", ".join(map(code, content)),
        )
    if refused:
        yield (
            ", ".join(refused),
            "refused, see [errors](../api.md#errors): [Problem](#problem)",
            code(PROBLEM),
        )


def _properties(schema: Mapping[str, Any]) -> Iterator[str]:
    if "$ref" in schema:
        yield f"As {_type(schema)}."
        return
    needed = schema.get("required", ())
    rows = [
        (
            code(name) + (" (required)" if name in needed else ""),
            _type(one) + _default(one),
            one.get("description", ""),
        )
        for name, one in schema.get("properties", {}).items()
    ]
    if rows:
        yield from table(("field", "type", "meaning"), rows)
    elif schema:
        yield f"{_type(schema)}."


def _default(schema: Mapping[str, Any]) -> str:
    return (
        f", default {code(json.dumps(schema['default']))}" if schema.get("default") not in (None, []) else ""
    )


def _type(schema: Mapping[str, Any]) -> str:
    """A type in words; schemas with a name as links to them."""
    if "$ref" in schema:
        name = schema["$ref"].rpartition("/")[2]
        return f"[{name}](#{name.lower()})"
    choices = schema.get("anyOf") or schema.get("oneOf")
    if choices:
        return " or ".join(dict.fromkeys(map(_type, choices)))
    if "const" in schema or "enum" in schema:
        return " or ".join(code(json.dumps(one)) for one in schema.get("enum", [schema.get("const")]))
    return _plain(schema)


def _plain(schema: Mapping[str, Any]) -> str:
    kind = str(schema.get("type", "anything" if schema else ""))
    if kind == "array":
        return f"array of {_type(schema.get('items', {})) or 'anything'}"
    if schema.get("format") == "binary":
        return "file"
    bounds = (("from", schema.get("minimum")), ("to", schema.get("maximum")))
    return " ".join([kind, *(f"{word} {_number(value)}" for word, value in bounds if value is not None)])


def _number(value: float) -> str:
    """Without a point where there is nothing after it; unsigned 64 bit as what it is."""
    return "2^64 - 1" if value == 2.0**64 else f"{value:g}"
