"""Bodies of requests, by media type, to plain field values; nothing is judged here but the form."""

import re
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, get_type_hints

from fastapi import Request
from python_multipart.multipart import parse_options_header

from cspace.errors import InputError
from cspace.query import SampleQuery
from inference_api.bodies.bounded_json import MAX_MARKS, MAX_TENSOR_MARKS, load_json, parse_json
from inference_api.bodies.multipart_form import Part, is_boundary, read_parts
from inference_api.problems import MALFORMED_BODY, UNSUPPORTED_MEDIA_TYPE, RequestError

MAX_CONTENT_TYPE = 500
# More is no number that anybody writes, but work for the expressions below.
_MAX_NUMBER = 400

_WHOLE = re.compile(r"[+-]?[0-9]{1,40}", re.ASCII)
_NUMBER = re.compile(r"[+-]?([0-9]+(\.[0-9]*)?|\.[0-9]+)([eE][+-]?[0-9]{1,4})?", re.ASCII)
_SCHEDULE, _CONFIGURATION, _CONFIGURATIONS = tuple[float, ...], tuple[float, ...] | None, "configurations"
_CAMERA = "camera"
_JSON_MARKS = {_CONFIGURATION: MAX_MARKS, _CAMERA: MAX_MARKS, _CONFIGURATIONS: MAX_TENSOR_MARKS}
# Of several pictures of a scene each has its own, and of views there may be several.
_REPEATED = ("image", "camera", "view")
_SCENE = {"camera": _CAMERA, "state": _CONFIGURATION, "depth_scale_m": float | None}
_FLAGS = {"true": True, "false": False}


@dataclass(frozen=True, slots=True)
class Form:
    """The fields of a page that takes pictures.

    Args:
        types: by name, as a form writes them: numbers, one field for each value of a schedule, configurations
            as JSON. Others are texts.
        either: those that come as a file or as a text; ``image`` is a file, all others are texts.
        most_marks: commas, colons and opening brackets in JSON.
    """

    types: Mapping[str, Any]
    either: frozenset[str] = frozenset()
    most_marks: int = MAX_MARKS

    def fits(self, name: str, value: bytes | str) -> bool:
        """Whether a field of a form came as what it is; unknown ones do."""
        if name in self.either or name not in ("image", "model", *self.types):
            return True
        return isinstance(value, bytes) == (name == "image")


SAMPLE_FORM = Form(get_type_hints(SampleQuery) | _SCENE)
VALIDITY_FORM = Form(
    {_CONFIGURATIONS: _CONFIGURATIONS, "robot": str | None, **_SCENE},
    frozenset((_CONFIGURATIONS,)),
    MAX_TENSOR_MARKS,
)
PLAN_FORM = Form(
    {
        "start": _CONFIGURATION,
        "goal": _CONFIGURATION,
        "seed": int,
        "min_confidence": float | None,
        "time_limit_s": float | None,
        "ways": int,
        "alternatives": bool,
        "next_view": bool,
        "view": _CAMERA,
        "robot": str | None,
        **_SCENE,
    }
)


@dataclass(frozen=True, slots=True)
class RawFields:
    """A body that is read and not parsed yet.

    Args:
        body: as it came.
        boundary: of a multipart form; None for JSON.
    """

    body: bytes
    boundary: bytes | None = None

    @property
    def json_bytes(self) -> int:
        """How much JSON there is to parse; a form's fields are small."""
        return len(self.body) if self.boundary is None else 0


async def read_fields(request: Request) -> RawFields:
    """Read a body whose media type is supported; on the event loop nothing more is done with it.

    Raises:
        RequestError: another media type, a form without a usable boundary, or a body that is too large.
    """
    coding = request.headers.get("content-encoding", "identity").strip().lower()
    content_type = request.headers.get("content-type", "")
    media_type, options = parse_options_header(content_type if len(content_type) <= MAX_CONTENT_TYPE else "")
    if coding != "identity" or media_type not in (b"application/json", b"multipart/form-data"):
        raise RequestError(
            UNSUPPORTED_MEDIA_TYPE,
            "the body's media type is not supported",
            expected="multipart/form-data or application/json, without a content coding",
            got=f"{content_type[:100] or 'no content type'}, {coding}"[:200],
        )
    if media_type == b"application/json":
        return RawFields(await request.body())
    boundary = options.get(b"boundary", b"")
    if not is_boundary(boundary):
        raise RequestError(
            MALFORMED_BODY,
            "the multipart body has no usable boundary",
            expected="a boundary of 1 to 70 letters, digits and '()+_,-./:=? in the content type",
            got=repr(boundary)[:100],
        )
    return RawFields(await request.body(), boundary)


def parse_fields(raw: RawFields, form: Form = SAMPLE_FORM) -> dict[str, Any]:
    """The values of a body's fields by name; for a thread, for it may take a tenth of a second.

    Args:
        raw: the body.
        form: the fields of the page.

    Raises:
        InputError: a field that is not repeatable is repeated, or file and text are mixed up.
        RequestError: the body or an array in it is malformed.
    """
    if raw.boundary is None:
        return parse_json(raw.body, form.most_marks)
    return _values(read_parts(raw.body, raw.boundary), form)


def _values(parts: list[Part], form: Form) -> dict[str, Any]:
    """Of a form; text that is no number stays text, for the schema to refuse."""
    values: dict[str, Any] = {}
    for part in parts:
        name, value = part.name, part.value
        if not form.fits(name, value):
            told = [
                "image as a file",
                *(f"{one} as either" for one in form.either),
                "every other field as text",
            ]
            raise InputError(
                f"{name} came in the wrong form",
                expected=", ".join(told),
                got="a file" if isinstance(value, bytes) else "text",
            )
        kind = form.types.get(name)
        if kind == _SCHEDULE or name in _REPEATED:
            values.setdefault(name, []).append(_convert(name, value, kind))
        elif name in values:
            raise InputError(f"{name[:100]} is repeated", expected="one value", got="several")
        else:
            values[name] = _convert(name, value, kind)
    return values


def _convert(name: str, value: bytes | str, kind: Any) -> object:
    if isinstance(value, bytes):
        return value
    text = value.strip()
    if kind is int and _WHOLE.fullmatch(text):
        return int(text)
    if kind in (float | None, _SCHEDULE) and len(text) <= _MAX_NUMBER and _NUMBER.fullmatch(text):
        return float(text)
    if kind is bool and text in _FLAGS:
        return _FLAGS[text]
    if kind in _JSON_MARKS:
        return load_json(name, text.encode("utf-8"), _JSON_MARKS[kind])
    return value
