"""Bodies of requests, by media type, to plain field values; nothing is judged here but the form."""

import json
import re
from dataclasses import dataclass
from typing import Any

from fastapi import Request
from python_multipart.multipart import parse_options_header

from cspace.errors import InputError
from inference_api.problems import MALFORMED_BODY, UNSUPPORTED_MEDIA_TYPE, RequestError

# A form has eight names, one of them repeatable.
MAX_FORM_FIELDS = 2000
MAX_FORM_FILES = 16
MAX_FIELD_BYTES = 64 * 1024

_WHOLE = re.compile(r"[+-]?[0-9]{1,40}", re.ASCII)
_NUMBER = re.compile(r"[+-]?([0-9]+\.?[0-9]*|\.[0-9]+)([eE][+-]?[0-9]{1,4})?", re.ASCII)
_WHOLE_FIELDS = ("n", "seed")
_NUMBER_FIELDS = ("min_confidence",)
_ARRAY_FIELDS = ("start", "goal")
KNOWN_FIELDS = ("image", "model", "epsilon_sigma", *_WHOLE_FIELDS, *_NUMBER_FIELDS, *_ARRAY_FIELDS)


@dataclass(frozen=True, slots=True)
class Part:
    """One part of a multipart form.

    Args:
        name: of the field.
        value: a file's bytes, or a plain field's text.
    """

    name: str
    value: bytes | str


RawFields = bytes | list[Part]


async def read_fields(request: Request) -> RawFields:
    """Read a body: JSON as bytes, a multipart form as its parts.

    Raises:
        RequestError: another media type, a body that is too large, or a form that is torn.
    """
    coding = request.headers.get("content-encoding", "identity").strip().lower()
    media_type, options = parse_options_header(request.headers.get("content-type"))
    if coding != "identity" or media_type not in (b"application/json", b"multipart/form-data"):
        raise RequestError(
            UNSUPPORTED_MEDIA_TYPE,
            "the body's media type is not supported",
            expected="multipart/form-data or application/json, without a content coding",
            got=f"{media_type.decode('latin-1') or 'no content type'}, {coding}"[:200],
        )
    body = await request.body()
    if media_type == b"application/json":
        return body
    end = b"--" + options.get(b"boundary", b"") + b"--"
    if end not in body:
        raise RequestError(
            MALFORMED_BODY,
            "the multipart body is torn",
            expected="a boundary in the content type and a body that ends with it",
            got=f"{len(body)} bytes without it",
        )
    limits = {"max_files": MAX_FORM_FILES, "max_fields": MAX_FORM_FIELDS, "max_part_size": MAX_FIELD_BYTES}
    async with request.form(**limits) as form:
        return [
            Part(name, value if isinstance(value, str) else await value.read())
            for name, value in form.multi_items()
        ]


def parse_json(body: bytes) -> dict[str, Any]:
    """A JSON object with unique keys and finite numbers.

    Raises:
        RequestError: the body is not that.
    """
    values = load_json("the body", body)
    if not isinstance(values, dict):
        raise RequestError(
            MALFORMED_BODY, "the body is no JSON object", expected="an object", got=type(values).__name__
        )
    return values


def parse_form(parts: list[Part]) -> dict[str, Any]:
    """The fields of a form; text that is no number stays text, for the schema to refuse.

    Raises:
        InputError: a field that is not repeatable is repeated, or file and text are mixed up.
        RequestError: an array is not JSON.
    """
    values: dict[str, Any] = {}
    for part in parts:
        name, value = part.name, part.value
        if name in KNOWN_FIELDS and isinstance(value, bytes) != (name == "image"):
            raise InputError(
                f"{name} came in the wrong form",
                expected="image as a file, every other field as text",
                got="a file" if isinstance(value, bytes) else "text",
            )
        if name == "epsilon_sigma":
            values.setdefault(name, []).append(_convert(name, value))
        elif name in values:
            raise InputError(f"{name} is repeated", expected="one value", got="several")
        else:
            values[name] = _convert(name, value)
    return values


def _convert(name: str, value: bytes | str) -> object:
    if isinstance(value, bytes):
        return value
    text = value.strip()
    if name in _WHOLE_FIELDS and _WHOLE.fullmatch(text):
        return int(text)
    if name in (*_NUMBER_FIELDS, "epsilon_sigma") and _NUMBER.fullmatch(text):
        return float(text)
    if name in _ARRAY_FIELDS:
        return load_json(name, text.encode("utf-8", errors="replace"))
    return value


def load_json(what: str, data: bytes) -> object:
    """Strict JSON: UTF-8, finite numbers, unique keys.

    Args:
        what: the text's name in messages.
        data: the text.

    Raises:
        RequestError: it is not that.
    """
    try:
        return json.loads(data.decode("utf-8"), parse_constant=_refuse, object_pairs_hook=_unique)
    except (ValueError, RecursionError) as error:
        raise RequestError(
            MALFORMED_BODY,
            f"{what} is not JSON",
            expected="UTF-8 JSON, not deeply nested, with finite numbers and unique keys",
            got=str(error)[:200],
        ) from error


def _refuse(name: str) -> float:
    raise ValueError(f"{name} is not JSON")


def _unique(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    values = dict(pairs)
    if len(values) != len(pairs):
        raise ValueError("a key stands twice in one object")
    return values
