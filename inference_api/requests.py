"""From a request to its answer: read the body, parse it, find the model, compute in turns.

A body is multipart/form-data or JSON with the same field names. Starlette reads forms and pydantic's parser
reads JSON; both are bounded before they cost much. Everything after reading happens in the scheduler's
threads, and the client pays there for what its request costs.
"""

import asyncio
import base64
import re
from collections.abc import AsyncGenerator, Callable, Mapping
from dataclasses import dataclass
from functools import partial
from typing import Annotated, Any, TypeVar

from fastapi import Depends, Request
from fastapi.responses import Response
from pydantic import BaseModel
from pydantic_core import from_json
from python_multipart.multipart import parse_options_header
from starlette.datastructures import Headers
from starlette.formparsers import MultiPartException, MultiPartParser

from cspace.errors import InputError
from inference_api.limits import client_of
from inference_api.models.served import ServedModel
from inference_api.models.store import ModelStore
from inference_api.problem_types import (
    MALFORMED_BODY,
    MEDIA_TYPE,
    UNSUPPORTED_MEDIA_TYPE,
    ProblemType,
    RequestError,
)
from inference_api.scheduler import Job, Lookups, Scheduler, rows_of
from inference_api.schemas import ModelFields, RequestFields
from inference_api.telemetry import Metrics
from services.outcomes import Receipts, Spool
from services.registry.entities import ModelReference

NPY = "application/x-npy"
# A request that waits or computes for so long is ended where its client goes away.
WATCH_AFTER_S = 0.1
MAX_CONTENT_TYPE = 500
# Commas, colons and opening brackets of a JSON text: what it holds takes up to 100 bytes each.
MAX_MARKS = 100_000
# A picture of 8 MiB in base64 whose slashes are escaped, as PHP writes them, has 130,000.
MAX_ESCAPES = 200_000
_MARKS = (("values", (b",", b":", b"[", b"{"), MAX_MARKS), ("escapes", (b"\\",), MAX_ESCAPES))
# A form has about 1020 fields at most: a schedule of 1000 values, pictures and cameras.
MAX_FIELDS, MAX_FILES, MAX_FIELD_BYTES = 1_100, 16, 64 * 1024
# In the header of a part. Reading an option costs a microsecond, in each of many parts.
MAX_SEMICOLONS = 32
# Files of a form, and the field that they become.
MESH, MESHES = "mesh", "meshes"
_PIECE_BYTES = 64 * 1024
# RFC 2046, section 5.1.1.
_BOUNDARY = re.compile(rb"[0-9A-Za-z'()+_,./:=? -]{0,69}[0-9A-Za-z'()+_,./:=?-]", re.ASCII)

Fields = TypeVar("Fields", bound=ModelFields)
Work = Callable[[ServedModel, Job], Response]
# Parses and validates in its turn: the model that is named, and what is to be done with it.
Parse = Callable[[Job], tuple[ModelReference, Work]]


@dataclass(frozen=True, slots=True)
class Service:
    """What routes are given.

    Args:
        store: where the models are.
        scheduler: in whose turns requests are computed.
        lookups: where requests wait for models that have to be fetched.
        metrics: of the app.
        spool: of outcomes; None keeps none.
        receipts: of answers; None without a spool.
        keep_s: how long pictures and paths of plans may be kept that are asked to be, s; 0 for not at all.
    """

    store: ModelStore
    scheduler: Scheduler
    lookups: Lookups
    metrics: Metrics
    spool: Spool | None = None
    receipts: Receipts | None = None
    keep_s: float = 0.0

    async def respond(self, request: Request, parse: Parse) -> Response:
        """The answer to a request whose body has been read.

        A model that is in memory answers in the turn in which the request was parsed. One that is not is
        looked up and loaded while nobody's turn is taken.

        Raises:
            CspaceError: as the contract's table of errors.
            ClientDisconnect: the client has gone away.
        """
        client, watch = client_of(request.scope), partial(_watch, request)

        def first(job: Job) -> Response | tuple[ModelReference, Work]:
            reference, work = parse(job)
            served = self.store.resolve_now(reference)
            return (reference, work) if served is None else work(served, job)

        found = await self.scheduler.run(first, client, watch)
        if isinstance(found, Response):
            return found
        reference, work = found
        served = await self.lookups.run(partial(self.store.resolve, reference), client)
        return await self.scheduler.run(partial(work, served), client, watch)

    async def answer(
        self,
        request: Request,
        kind: type[Fields],
        work: Callable[[Fields, ServedModel, Job], Response],
    ) -> Response:
        """The answer to a request with fields, which are read here; raises as :meth:`respond`."""
        body = await read_body(request)

        def parse(job: Job) -> tuple[ModelReference, Work]:
            job.spend(rows_of(json_bytes=body.json_bytes))
            values = body.values(kind)
            job.check_cancelled()
            fields = kind.read(values)
            job.check_cancelled()
            return fields.reference(self.store.model_name), partial(work, fields)

        return await self.respond(request, parse)


# Asynchronous although it waits for nothing: a plain function would be sent to a thread.
async def get_service(request: Request) -> Service:
    """The app's :class:`Service`, for routes."""
    service: Service = request.app.state.service
    return service


Serving = Annotated[Service, Depends(get_service)]


def _watch(request: Request, leave: Callable[[], None]) -> Callable[[], None]:
    """Has ``leave`` called when the client goes away; what is returned ends that.

    It looks after :data:`WATCH_AFTER_S`, for most requests are answered before that and a task costs time.
    """
    waiting: asyncio.Task[None] | None = None

    async def wait() -> None:
        # The body has been read, so that nothing else can come.
        while (await request.receive())["type"] != "http.disconnect":
            pass
        leave()

    def begin() -> None:
        nonlocal waiting
        waiting = asyncio.ensure_future(wait())

    timer = asyncio.get_running_loop().call_later(WATCH_AFTER_S, begin)

    def end() -> None:
        timer.cancel()
        if waiting is not None:
            waiting.cancel()

    return end


@dataclass(frozen=True, slots=True)
class Body:
    """A body that was read and is not validated.

    Args:
        text: JSON; None for a form.
        parts: of a form, in their order: bytes of files, and texts.
        meshes: files of a form that come as `mesh`, by their names, in base64.
    """

    text: bytes | None = None
    parts: tuple[tuple[str, bytes | str], ...] = ()
    meshes: tuple[tuple[str, str], ...] = ()

    @property
    def json_bytes(self) -> int:
        """How much JSON there is to parse; a form's fields are small."""
        return len(self.text or b"")

    def values(self, kind: type[RequestFields]) -> dict[str, Any]:
        """The values of the fields by name; in a form a field that is repeated has all of them.

        Raises:
            InputError: the picture of a form is no file.
            RequestError: the JSON is malformed.
        """
        if self.text is not None:
            return load_object(self.text)
        values: dict[str, list[Any]] = {}
        for name, value in self.parts:
            if name == "image" and isinstance(value, str):
                raise InputError("image came as text", expected="a file in a form", got="text")
            values.setdefault(name, []).append(_form_value(name, value, kind))
        found = {name: many[0] if len(many) == 1 else many for name, many in values.items()}
        return found | ({MESHES: dict(self.meshes)} if self.meshes else {})


def _form_value(name: str, value: bytes | str, kind: type[RequestFields]) -> object:
    if isinstance(value, bytes) or name in kind.TEXTS or name not in kind.model_fields:
        return value
    try:
        return load_json(name, value.strip().encode())
    except RequestError:
        if value.lstrip()[:1] in ("[", "{"):
            raise
        # What is no number is refused by the field, in its words.
        return value


def load_object(text: bytes) -> dict[str, Any]:
    """A JSON object.

    Raises:
        RequestError: the text is not that.
    """
    values = load_json("the body", text)
    if not isinstance(values, dict):
        raise RequestError(
            MALFORMED_BODY, "the body is no JSON object", expected="an object", got=type(values).__name__
        )
    return values


def load_json(what: str, text: bytes) -> object:
    """JSON with finite numbers and a bounded number of values.

    Args:
        what: the text's name in messages.
        text: UTF-8.

    Raises:
        RequestError: it is not that.
    """
    for named, marks, most in _MARKS:
        if _holds_more(text, marks, most):
            raise RequestError(
                MALFORMED_BODY,
                f"{what} holds too many {named}",
                expected=f"at most {most} of {b' '.join(marks).decode()}",
                got="more",
                remedy="send pictures as PNG, or as binary tensors behind the JSON object",
            )
    try:
        return from_json(text, allow_inf_nan=False, cache_strings="none")
    except ValueError as error:
        raise RequestError(
            MALFORMED_BODY,
            f"{what} is not JSON",
            expected="UTF-8 JSON, not deeply nested, with finite numbers",
            got=str(error)[:200],
        ) from error


def _holds_more(text: bytes, marks: tuple[bytes, ...], most: int) -> bool:
    """Counted piece by piece: a count holds up all other threads, and so does parsing."""
    held = 0
    for start in range(0, len(text), _PIECE_BYTES):
        held += sum(text.count(mark, start, start + _PIECE_BYTES) for mark in marks)
        if held > most:
            return True
    return False


async def read_body(request: Request) -> Body:
    """Reads a form or JSON.

    Raises:
        RequestError: another media type, a malformed form, or a body that is too large or too late.
    """
    media_type, options = media_type_of(request, "multipart/form-data", "application/json")
    if media_type == "application/json":
        return Body(await request.body())
    boundary = options.get(b"boundary", b"")
    if not _BOUNDARY.fullmatch(boundary):
        raise RequestError(
            MALFORMED_BODY,
            "the multipart body has no usable boundary",
            expected="a boundary of 1 to 70 letters, digits and '()+_,-./:=? in the content type",
            got=repr(boundary)[:100],
        )
    body = await request.body()
    _check_boundaries(body, boundary)
    parser = _FormParser(boundary, body)
    try:
        form = await parser.parse()
    except MultiPartException as error:
        raise _malformed(error.message) from error
    parts, meshes = list[tuple[str, bytes | str]](), list[tuple[str, str]]()
    for name, value in form.multi_items():
        if isinstance(value, str):
            parts.append((name, value))
        elif name == MESH:
            meshes.append((value.filename or "", base64.b64encode(await value.read()).decode()))
        else:
            parts.append((name, await value.read()))
    await form.close()
    if not parser.ended:
        raise _malformed("a body without its last boundary")
    if len(dict(meshes)) < len(meshes):
        raise _malformed("two meshes of one file name")
    return Body(parts=tuple(parts), meshes=tuple(meshes))


def media_type_of(request: Request, *supported: str) -> tuple[str, dict[bytes, bytes]]:
    """The media type of a request's body, and its parameters.

    Raises:
        RequestError: it is none of those that are supported, or the body has a content coding.
    """
    coding = request.headers.get("content-encoding", "identity").strip().lower()
    content_type = request.headers.get("content-type", "")
    found, options = parse_options_header(content_type[:MAX_CONTENT_TYPE])
    media_type = found.decode("latin-1")
    if coding != "identity" or len(content_type) > MAX_CONTENT_TYPE or media_type not in supported:
        raise RequestError(
            UNSUPPORTED_MEDIA_TYPE,
            "the body's media type is not supported",
            expected=f"{' or '.join(filter(None, supported))}, without a content coding",
            got=f"{content_type[:100] or 'no content type'}, {coding}"[:200],
        )
    return media_type, options


class _FormParser(MultiPartParser):
    """Starlette's parser, with every file in memory and no codec of the client's choice."""

    spool_max_size = 2**30

    def __init__(self, boundary: bytes, body: bytes) -> None:
        # Without the character set that the client declares: its codec may take seconds.
        content_type = f'multipart/form-data; boundary="{boundary.decode("ascii")}"'
        super().__init__(
            Headers({"content-type": content_type}),
            _pieces(body),
            max_files=MAX_FILES,
            max_fields=MAX_FIELDS,
            max_part_size=MAX_FIELD_BYTES,
        )
        self.ended = False

    def on_headers_finished(self) -> None:
        """Refuses a part whose header would take long to read."""
        if (self._current_part.content_disposition or b"").count(b";") > MAX_SEMICOLONS:
            raise MultiPartException(f"more than {MAX_SEMICOLONS} semicolons in a Content-Disposition")
        super().on_headers_finished()

    def on_end(self) -> None:
        """The last boundary was there."""
        self.ended = True


async def _pieces(body: bytes) -> AsyncGenerator[bytes, None]:
    for at in range(0, len(body), _PIECE_BYTES):
        yield body[at : at + _PIECE_BYTES]
        # Others have their turns on the event loop.
        await asyncio.sleep(0)


def _check_boundaries(body: bytes, boundary: bytes) -> None:
    # The parser goes byte by byte through what only begins as a boundary, seconds for 8 MiB of it.
    mark = b"\r\n--" + boundary
    at, count = body.find(mark), 0
    while at >= 0 and count <= MAX_FIELDS + MAX_FILES:
        after = body[at + len(mark) : at + len(mark) + 2]
        if after == b"--":
            return
        if after != b"\r\n":
            raise _malformed("a boundary that goes on")
        count += 1
        at = body.find(mark, at + len(mark))
    if not body.startswith(b"--" + boundary + b"--"):
        raise _malformed("a body without its last boundary, or with too many")


def _malformed(got: str) -> RequestError:
    return RequestError(
        MALFORMED_BODY,
        "the multipart body is malformed",
        expected=f"parts with headers between boundaries, as RFC 7578 has it: at most {MAX_FILES} files and "
        f"{MAX_FIELDS} fields of {MAX_FIELD_BYTES} bytes, in UTF-8",
        got=got[:200],
        remedy="where configurations are many, send them as an .npy file or the request as JSON",
    )


def prefers_npy(accept: str | None) -> bool:
    """Whether an ``Accept`` header ranks ``.npy`` above JSON; it has to name it."""
    ranks = {NPY: 0.0, "application/json": 0.0}
    for entry in (accept or "").split(","):
        media_type, *parameters = (part.strip().lower() for part in entry.split(";"))
        if media_type in ranks:
            ranks[media_type] = max(ranks[media_type], _quality(parameters))
    return ranks[NPY] > 0.0 and ranks[NPY] >= ranks["application/json"]


def _quality(parameters: list[str]) -> float:
    for parameter in parameters:
        name, _, value = parameter.partition("=")
        if name.strip() == "q":
            try:
                return float(value)
            except ValueError:
                return 0.0
    return 1.0


def both_bodies(kind: type[BaseModel]) -> dict[str, Any]:
    """``openapi_extra`` of a route that takes a form, or JSON with the same names."""
    schema, form = kind.model_json_schema(), kind.model_json_schema()
    form["properties"] = {name: _in_form(name, one) for name, one in form["properties"].items()}
    content = {"multipart/form-data": {"schema": form}, "application/json": {"schema": schema}}
    return {"requestBody": {"required": True, "content": content}}


def _in_form(name: str, schema: dict[str, Any]) -> dict[str, Any]:
    """Of a field's JSON schema that of a form: files are binary, and what is a list is repeated."""
    file = {"type": "string", "format": "binary"}
    description = {"description": schema["description"]}
    if name == "configurations":
        return file | description
    if name == "image":
        many = schema["anyOf"][1] | {"items": file}
        return {"anyOf": [file, many]} | description
    if name == "epsilon_sigma":
        return {**schema["anyOf"][1], **description}
    return schema


def problem_responses(*problems: ProblemType) -> dict[int | str, dict[str, Any]]:
    """Answers that are problems, one entry a status, for a route's ``responses``."""
    responses: dict[int | str, dict[str, Any]] = {}
    for status in dict.fromkeys(problem.status for problem in problems):
        same = [problem for problem in problems if problem.status == status]
        examples: Mapping[str, Any] = {
            one.name: {"value": {"type": one.uri, "title": one.title, "status": status, "detail": "..."}}
            for one in same
        }
        responses[status] = {
            "description": "; ".join(problem.title for problem in same) + ".",
            "content": {
                MEDIA_TYPE: {"schema": {"$ref": "#/components/schemas/Problem"}, "examples": examples}
            },
        }
    return responses
