"""What goes between the API and its children: one JSON object a line, errors by name from a fixed table."""

import json
from collections.abc import Mapping
from typing import Any

from cspace.errors import (
    BundleError,
    BundleIntegrityError,
    CspaceError,
    GoldenMismatchError,
    ModelNotFoundError,
    RegistryError,
    RegistryUnavailableError,
    StorageBusyError,
    StorageError,
)
from services.registry.failures import failure_of
from services.registry.scrubbing import anonymous

# A list of some thousand versions with their decision logs.
MAX_LINE_BYTES = 16 * 2**20
_KINDS: dict[str, type[CspaceError]] = {
    kind.__name__: kind
    for kind in (
        BundleError,
        BundleIntegrityError,
        GoldenMismatchError,
        ModelNotFoundError,
        RegistryError,
        RegistryUnavailableError,
        StorageBusyError,
        StorageError,
    )
}
_FIELDS = ("expected", "got", "remedy")


def to_line(message: Mapping[str, Any]) -> bytes:
    """A message as one line."""
    return json.dumps(message).encode() + b"\n"


def from_line(line: bytes) -> dict[str, Any]:
    """The inverse of :func:`to_line`.

    Raises:
        ValueError: the line is no JSON object.
    """
    try:
        message = json.loads(line)
    except RecursionError as error:
        raise ValueError("nested too deeply") from error
    if not isinstance(message, dict):
        raise ValueError("not an object")  # noqa: TRY004 - what came over the pipe
    return message


def error_values(error: CspaceError) -> dict[str, Any]:
    """An error for the API, which shows it to clients and writes it to its log: no address, no path."""
    kind = next(kind.__name__ for kind in type(error).__mro__ if kind.__name__ in {*_KINDS, "CspaceError"})
    fields = {name: getattr(error, name) for name in _FIELDS}
    if isinstance(error, RegistryError | StorageError) and error.__cause__ is not None:
        # What others wrote may hold anything; only the kind of failure is told on.
        fields["got"] = failure_of(error.__cause__)
    told = {name: None if text is None else anonymous(text) for name, text in fields.items()}
    return {"kind": kind, "what": anonymous(error.what), **told}


def error_of(values: object) -> CspaceError:
    """The inverse of :func:`error_values`.

    Raises:
        ValueError: no error, or one of no known kind.
    """
    if not isinstance(values, dict) or set(values) != {"kind", "what", *_FIELDS}:
        raise ValueError("not an error")
    kind = _KINDS.get(str(values["kind"]))
    texts = [values[name] for name in _FIELDS]
    if kind is None or not isinstance(values["what"], str):
        raise ValueError("an error of no known kind")
    if not all(text is None or isinstance(text, str) for text in texts):
        raise ValueError("an error without texts")
    return kind(values["what"], **dict(zip(_FIELDS, texts, strict=True)))
