"""Files and texts from outside: bounded reads, atomic writes, locks, .npy, PNG, YAML, JSON by pydantic."""

import fcntl
import io
import json
import re
import secrets
import shutil
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import field
from functools import cache, wraps
from pathlib import Path
from typing import Annotated, Any, TypeVar, cast, dataclass_transform

import numpy as np
from numpy.typing import NDArray
from PIL import Image
from pydantic import AfterValidator, ConfigDict, Field, TypeAdapter, ValidationError
from pydantic.dataclasses import dataclass
from pydantic_core import from_json, to_jsonable_python

from cspace.errors import CspaceError, ImageError, StorageError

# How the names of half-written things begin and end, for those who clear up after killed processes.
HALF_PREFIX, HALF_SUFFIX = ".write-", ".tmp"
# Aliases can stand for parts with aliases: with so many, for e^(20 / e) or 1,600 times the text.
MAX_YAML_BYTES, _MAX_ALIASES = 2**20, 20
_LOOK_EVERY_S = 0.2


def read_bounded(
    path: Path, most_bytes: int, error: type[CspaceError], *, remedy: str | None = None
) -> bytes:
    """What a file, a pipe or a device holds, where it is not too much."""
    try:
        with path.open("rb") as file:
            data = file.read(most_bytes + 1)
    except (OSError, ValueError) as problem:
        # A ValueError: a name with a zero byte.
        raise error(f"{path} cannot be read", expected="a file", got=str(problem), remedy=remedy) from problem
    if len(data) > most_bytes:
        raise error(f"{path} is too large", expected=f"at most {most_bytes} bytes", got="more")
    return data


@contextmanager
def replacing(path: Path, what: str | None = None) -> Iterator[Path]:
    """A path beside another, for a file or an empty folder, that takes its place when the block ends well."""
    # Processes on several machines may write the same file at the same time.
    beside = path.with_name(f"{HALF_PREFIX}{path.name}-{secrets.token_hex(4)}{HALF_SUFFIX}")
    try:
        yield beside
        beside.replace(path)
    except OSError as error:
        if what is None:
            raise
        raise StorageError(f"{what} cannot be written", got=error.strerror or type(error).__name__) from error
    finally:
        discard(beside)


@contextmanager
def holding(path: Path, busy: CspaceError, wait_s: float = 0.0) -> Iterator[None]:
    """Hold a lock file, which stays; the system frees it when the process ends, however it ends."""
    until_s = time.monotonic() + wait_s
    with path.open("a", encoding="utf-8") as handle:
        while True:
            try:
                fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
                break
            except BlockingIOError:
                if time.monotonic() >= until_s:
                    raise busy from None
                time.sleep(_LOOK_EVERY_S)
        yield


def make_output_folder(folder: Path) -> None:
    """Make a folder for output, which Git and Ray ignore unless it holds something already."""
    folder.mkdir(parents=True, exist_ok=True)
    if not any(folder.iterdir()):
        (folder / ".gitignore").write_text("*\n", encoding="utf-8")


def discard(path: Path) -> None:
    """Delete a file or a folder, as far as that goes, if it is there."""
    if path.is_dir():
        shutil.rmtree(path, ignore_errors=True)
    else:
        with suppress(OSError):
            path.unlink()


def read_npy(data: bytes, types: tuple[str, ...], axes: int) -> NDArray[Any]:
    """An untrusted ``.npy`` file of one of the types, as ``<f4``, and of so many axes; else a ValueError."""
    stream = io.BytesIO(data)
    try:
        found = np.lib.format.read_array(stream, allow_pickle=False)
    except (EOFError, MemoryError) as error:
        raise ValueError(str(error) or "an array that does not end") from error
    if found.dtype.str not in types or found.ndim != axes or stream.read(1):
        raise ValueError(f"an array of type {found.dtype} and shape {found.shape}")
    return np.asarray(found)


def map_npy(path: Path, error: type[CspaceError]) -> NDArray[Any]:
    """A ``.npy`` file as a read-only array that is mapped, so that no shape is larger than its file."""
    try:
        mapped: NDArray[Any] = np.lib.format.open_memmap(path, mode="r")
    except Exception as problem:
        # All, for there is no list of what evaluating a header raises.
        got = str(problem)[:200] or type(problem).__name__
        raise error(f"{path} is no array", expected="a .npy file of numbers", got=got) from problem
    return mapped


def open_png(data: bytes, check: Callable[[Image.Image], None]) -> Image.Image:
    """An untrusted PNG file as Pillow decodes it; ``check`` refuses it by mode and size before that."""
    try:
        picture = Image.open(io.BytesIO(data), formats=["PNG"])
        if getattr(picture, "is_animated", False):
            raise ImageError("the picture is animated", expected="one frame")  # noqa: TRY301
        check(picture)
        picture.load()
    except ImageError:
        raise
    except Exception as error:
        # All, for there is no list of what a decoder raises for bytes from outside.
        got = re.sub("<.*>", "bytes", str(error))[:200] or type(error).__name__
        raise ImageError(
            "the picture is not a PNG, or damaged", expected="a complete PNG file", got=got
        ) from error
    return picture


def encode_png(image: NDArray[np.uint8]) -> bytes:
    """A picture, (H, W, 3) uint8 or (H, W) uint16, as PNG bytes."""
    buffer = io.BytesIO()
    Image.fromarray(np.ascontiguousarray(image)).save(buffer, format="PNG")
    return buffer.getvalue()


def read_yaml(text: bytes | str, name: str, error: type[CspaceError]) -> Any:
    """The plain values of a text, YAML or JSON, of at most 1 MiB; None where it is empty."""
    if len(text) > MAX_YAML_BYTES:
        raise error(f"{name} is too large", expected=f"at most {MAX_YAML_BYTES} bytes", got=f"{len(text)}")
    # Not every installation has it.
    import yaml  # noqa: PLC0415

    class Loader(yaml.SafeLoader):
        """With few aliases; reads the numbers of JSON as such: YAML 1.1 takes 1e-3 for a text."""

        aliases = 0

        def compose_node(self, parent: Any, index: Any) -> Any:
            if self.check_event(yaml.AliasEvent):
                self.aliases += 1
                whole = self.anchors.get(self.peek_event().anchor)  # type: ignore[no-untyped-call]
                if self.aliases > _MAX_ALIASES or (whole is not None and whole.end_mark is None):
                    raise yaml.YAMLError(f"more than {_MAX_ALIASES} aliases, or one within what it names")
            return super().compose_node(parent, index)

    number = re.compile(r"-?(?:0|[1-9]\d*)(?:\.\d+)?[eE][-+]?\d+")
    Loader.add_implicit_resolver("tag:yaml.org,2002:float", number, list("-0123456789"))
    try:
        return yaml.load(text, Loader=Loader)  # noqa: S506 - a safe one
    except (yaml.YAMLError, RecursionError, ValueError) as problem:
        raise error(f"{name} is no YAML", expected="YAML or JSON", got=str(problem)[:200]) from problem


def read_yaml_file(path: Path, error: type[CspaceError]) -> Any:
    """The values of a file, as :func:`read_yaml` gives them."""
    return read_yaml(read_bounded(path, MAX_YAML_BYTES, error), str(path), error)


Kind = TypeVar("Kind")
_Number = TypeVar("_Number", int, float)
_CONFIG = ConfigDict(extra="forbid", allow_inf_nan=False, arbitrary_types_allowed=True)
_UNKNOWN = ("extra_forbidden", "unexpected_keyword_argument")


def _in_order(span: tuple[_Number, _Number]) -> tuple[_Number, _Number]:
    if span[0] > span[1]:
        raise ValueError("a range from low to high")
    return span


Span = Annotated[tuple[_Number, _Number], AfterValidator(_in_order)]
Share = Annotated[float, Field(ge=0.0, le=1.0)]
# Of a field that is not written where it is None, and may be missing then.
LEFT_OUT = Field(exclude_if=lambda value: value is None)


def parse_json(data: bytes | str) -> Any:
    """The values of a text of a bounded size, at most 200 levels deep; a ValueError where it is no JSON."""
    return from_json(data, allow_inf_nan=False)


def read_json(data: bytes, where: str, error: type[CspaceError]) -> dict[str, Any]:
    """The members of an untrusted JSON object of a bounded size."""
    try:
        values = parse_json(data)
    except ValueError as problem:
        raise error(f"{where} is not JSON", expected="UTF-8 JSON", got=str(problem)[:200]) from problem
    return read_object(dict[str, Any], values, where, error)


def read_object(kind: type[Kind], values: object, where: str, error: type[CspaceError]) -> Kind:
    """A value of a type that pydantic knows, of plain values; only whole numbers and lists are converted."""
    try:
        text = json.dumps(values, default=repr)
        return cast("Kind", adapter_of(kind).validate_json(text, strict=True))  # type: ignore[arg-type] # hashable
    except ValidationError as problem:
        raise project_error(problem, error, where) from problem


def json_text(values: object) -> str:
    """The text of plain values, keys in order."""
    return json.dumps(values, indent=2, sort_keys=True, allow_nan=False) + "\n"


class Record:
    """Base of validated dataclasses that files hold."""

    __slots__ = ()

    def to_dict(self) -> dict[str, Any]:
        return cast("dict[str, Any]", to_jsonable_python(self))


@cache
def adapter_of(kind: Any) -> TypeAdapter[Any]:
    """Pydantic's adapter of a type, built once."""
    return TypeAdapter(kind)


def project_error(
    problem: ValidationError, error: type[CspaceError], where: str, remedy: str | None = None
) -> CspaceError:
    """The project's error for the first of pydantic's, or for the project's own that a validator raised."""
    wrong = problem.errors(include_url=False)
    # A missing key may be one that is misspelt.
    first = next((one for one in wrong if one["type"] in _UNKNOWN), wrong[0])
    own = first.get("ctx", {}).get("error")
    if isinstance(own, error):
        return own
    if isinstance(own, CspaceError):
        return error(f"{where}: {own.what}", expected=own.expected, got=own.got, remedy=own.remedy or remedy)
    path = ".".join(map(str, first["loc"]))[:200]
    place = f"{where}: {path}" if path else where
    if first["type"] == "missing":
        return error(f"{place} is missing", expected="a value", got="nothing", remedy=remedy)
    if first["type"] in _UNKNOWN:
        return error(f"{place} is unknown", expected="known keys alone", got=path, remedy=remedy)
    expected = first["msg"].removeprefix("Input should be ").removeprefix("Value error, ")
    return error(f"{place} does not fit", expected=expected, got=repr(first["input"])[:200], remedy=remedy)


@dataclass_transform(frozen_default=True, field_specifiers=(field, Field))
def validated(error: type[CspaceError]) -> Callable[[type[Kind]], type[Kind]]:
    """A decorator: a frozen pydantic dataclass whose constructor raises the project's error.

    Lists become tuples, and whole numbers become floats where these belong, so that a value is equal to what
    is read of the JSON that it writes.
    """

    def decorate(kind: type[Kind]) -> type[Kind]:
        made: Any = dataclass(frozen=True, slots=True, config=_CONFIG)(kind)
        construct, names = made.__init__, list(made.__dataclass_fields__)
        where = "the " + re.sub("(?<=[a-z])(?=[A-Z])", " ", kind.__name__).lower()

        @wraps(construct)
        def init(self: Any, *values: Any, **named: Any) -> None:
            try:
                # By name, as pydantic would give the position of a value as its place.
                construct(self, *values[len(names) :], **dict(zip(names, values, strict=False)), **named)
            except ValidationError as problem:
                raise project_error(problem, error, where) from problem

        made.__init__ = init
        return cast("type[Kind]", made)

    return decorate
