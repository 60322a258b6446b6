"""The body of a request as a pydantic model: a form, or JSON with the same names."""

import base64
import codecs
import re
from collections.abc import Awaitable, Callable
from functools import cache
from typing import Any, TypeVar

from anyio import to_thread
from fastapi import Request
from fastapi.exceptions import RequestValidationError
from pydantic import BaseModel, ValidationError
from pydantic_core import from_json
from python_multipart.multipart import parse_options_header
from starlette.datastructures import Headers
from starlette.formparsers import MultiPartException, MultiPartParser

from cspace_client.wire import FORM_TEXTS
from inference_api.limits import MAX_BODY_BYTES
from inference_api.problems import BODY_TOO_LARGE, MALFORMED_BODY, UNSUPPORTED_MEDIA_TYPE, RequestError

FORM, JSON = "multipart/form-data", "application/json"
# A form has about 1020 fields at most: a schedule of 1000 values, pictures and cameras.
MAX_FIELDS, MAX_FILES, MAX_FIELD_BYTES = 1_100, 48, 64 * 1024
# Reading it takes longer than to hand it to a thread.
_LONG_JSON_BYTES = 64 * 1024
# Of JSON beside its pictures: parsed, it takes up to 27 times as much memory, while other threads wait.
MAX_JSON_BYTES = 1024 * 1024
_PICTURE = re.compile(rb'"(?:data:[a-z0-9/.+;=-]{,60},)?[A-Za-z0-9+/=_\\-]{1024,}"')
# As PHP and jQuery name the values of a list, and as JavaScript joins them.
_INDEX = re.compile(r"\[\d*\]$")
_NUMBERS = re.compile(r"[-.\dEe+]+(?:[\s,]+[-.\dEe+]+)+")
_CONSTANTS = ("true", "false", "null")
Fields = TypeVar("Fields", bound=BaseModel)


class _FormParser(MultiPartParser):
    # In memory, for the file system may be read-only.
    spool_max_size = MAX_BODY_BYTES


@cache
def body_of(kind: type[Fields], *media_types: str) -> Callable[[Request], Awaitable[Fields]]:
    """A dependency: the body as a model; without ``media_types`` a form or JSON."""

    async def read(request: Request) -> Fields:
        media_type, options = _media_type(request, media_types or (FORM, JSON))
        if media_type == FORM:
            return validated(kind, await _form_values(request, kind, options.get(b"boundary", b"")))
        body = await request.body()
        if len(body) > _LONG_JSON_BYTES:
            return await to_thread.run_sync(_of_json, kind, body, limiter=request.app.state.places.parsing)
        return _of_json(kind, body)

    return read


def validated(kind: type[Fields], values: object) -> Fields:
    """The model of plain values; its errors are those of the request."""
    try:
        return kind.model_validate(values)
    except ValidationError as error:
        raise RequestValidationError(error.errors(include_url=False, include_context=False)) from error


def _of_json(kind: type[Fields], body: bytes) -> Fields:
    if len(body) > MAX_JSON_BYTES and len(_PICTURE.sub(b"", body)) > MAX_JSON_BYTES:
        raise RequestError(
            BODY_TOO_LARGE,
            "the JSON body is too large",
            expected=f"at most {MAX_JSON_BYTES} bytes beside pictures in base64",
            remedy="send configurations as .npy in a form",
        )
    values = _json("the body", body.removeprefix(codecs.BOM_UTF8))
    if not isinstance(values, dict):
        raise _malformed("the body is no JSON object", "an object", type(values).__name__)
    return validated(kind, values)


def _json(what: str, text: bytes) -> object:
    try:
        return from_json(text, allow_inf_nan=False, cache_strings="none")
    except ValueError as error:
        expected = "UTF-8 JSON, not deeply nested, with finite numbers"
        raise _malformed(f"{what} is not JSON", expected, str(error)[:200]) from error


async def _form_values(request: Request, kind: type[BaseModel], boundary: bytes) -> dict[str, Any]:
    """Fields by name: files as bytes, texts, and JSON; all values of a field that is repeated."""
    # Without the character set that the client names: its codec may take seconds.
    content_type = f'{FORM}; boundary="{boundary.decode("latin-1")}"'
    parser = _FormParser(
        Headers({"content-type": content_type}),
        request.stream(),
        max_files=MAX_FILES,
        max_fields=MAX_FIELDS,
        max_part_size=MAX_FIELD_BYTES,
    )
    try:
        form = await parser.parse()
    except MultiPartException as error:
        raise RequestError(
            MALFORMED_BODY,
            "the form is malformed",
            expected="parts as RFC 7578 has them",
            got=error.message,
            remedy="give the part of a picture or an array a file name",
        ) from error
    values: dict[str, list[Any]] = {}
    meshes: dict[str, str] = {}
    for field, part in form.multi_items():
        name = _INDEX.sub("", field)
        if name == "mesh" and not isinstance(part, str):
            meshes[part.filename or ""] = base64.b64encode(await part.read()).decode()
        else:
            value = part if isinstance(part, str) else await part.read()
            values.setdefault(name, []).append(_form_value(name, value, kind))
    await form.close()
    found: dict[str, Any] = {name: many[0] if len(many) == 1 else many for name, many in values.items()}
    return found | ({"meshes": meshes} if meshes else {})


def _form_value(name: str, value: str | bytes, kind: type[BaseModel]) -> object:
    """A field's value: JSON also comes as a file, and a picture without a file name as text."""
    if name == "image":
        return value.encode("latin-1") if isinstance(value, str) and value[:1] == "\x89" else value
    if isinstance(value, bytes):
        if name == "configurations" and value.lstrip()[:1] != b"[":
            return value
        value = value.decode("utf-8", "replace")
    if name in FORM_TEXTS or name not in kind.model_fields:
        return value
    text = value.strip()
    if _NUMBERS.fullmatch(text):
        text = f"[{','.join(text.replace(',', ' ').split())}]"
    try:
        return _json(name, (text.lower() if text.lower() in _CONSTANTS else text).encode())
    except RequestError:
        if text[:1] in ("[", "{"):
            raise
        # The field refuses it in its own words.
        return value


def _media_type(request: Request, supported: tuple[str, ...]) -> tuple[str, dict[bytes, bytes]]:
    coding = request.headers.get("content-encoding", "identity").strip().lower()
    content_type = request.headers.get("content-type", "")
    found, options = parse_options_header(content_type[:500])
    media_type = found.decode("latin-1")
    if coding != "identity" or media_type not in supported:
        raise RequestError(
            UNSUPPORTED_MEDIA_TYPE,
            "the body's media type is not supported",
            expected=f"{' or '.join(supported)}, without a content coding",
            got=f"{content_type[:100] or 'no content type'}, {coding}"[:200],
        )
    return media_type, options


def _malformed(what: str, expected: str, got: str) -> RequestError:
    return RequestError(MALFORMED_BODY, what, expected=expected, got=got)


def both_bodies(kind: type[BaseModel]) -> dict[str, Any]:
    """``openapi_extra`` of a route that takes a form or JSON."""
    form = kind.model_json_schema(ref_template="#/components/schemas/{model}")
    del form["$defs"]
    file = {"type": "string", "format": "binary"}
    form["properties"]["image"] = {"type": "array", "items": file, "minItems": 1, "maxItems": 4}
    if "configurations" in form["properties"]:
        form["properties"]["configurations"] = file
    json = {"$ref": f"#/components/schemas/{kind.__name__}"}
    return {"requestBody": {"required": True, "content": {FORM: {"schema": form}, JSON: {"schema": json}}}}
