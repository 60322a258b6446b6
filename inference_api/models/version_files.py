"""What the registry said about a version as JSON: from the children, and beside its bundle in the cache."""

import json
from collections.abc import Mapping
from dataclasses import fields
from pathlib import Path
from typing import Any

from cspace.files import write_json
from services.registry.models.port import ModelVersion

# More than any description has; what is longer is somebody else's file.
MAX_BYTES = 2**20
MAX_TEXT = 20_000
_FIELDS = {field.name for field in fields(ModelVersion)}


def to_values(version: ModelVersion) -> dict[str, Any]:
    """A version as JSON has it."""
    return {**vars(version), "aliases": list(version.aliases), "tags": dict(version.tags)}


def from_values(values: object) -> ModelVersion:
    """The inverse of :func:`to_values`.

    Raises:
        ValueError: other keys, or a value of another type or length.
    """
    if not isinstance(values, dict) or set(values) != _FIELDS:
        raise ValueError("not a version")
    aliases, tags = values["aliases"], values["tags"]
    if not isinstance(aliases, list) or not isinstance(tags, dict):
        raise ValueError("not a version's aliases and tags")  # noqa: TRY004 - a value of a file
    return ModelVersion(
        name=_text(values["name"]),
        number=_count(values["number"]),
        run_id=_text(values["run_id"]),
        digest=_text(values["digest"]),
        aliases=tuple(map(_text, aliases)),
        tags={_text(key): _text(value) for key, value in tags.items()},
        created_ms=_count(values["created_ms"]),
    )


def write_version(path: Path, version: ModelVersion) -> None:
    """Write a version's description, beside and renamed.

    Raises:
        OSError: the file cannot be written.
    """
    write_json(path, to_values(version))


def read_version(path: Path) -> ModelVersion | None:
    """Read a description; None when it is missing or damaged, for it is only a copy."""
    try:
        with path.open("rb") as file:
            data = file.read(MAX_BYTES + 1)
        return from_values(_parsed(data))
    except (OSError, ValueError, RecursionError):
        return None


def _parsed(data: bytes) -> Mapping[str, Any]:
    if len(data) > MAX_BYTES:
        raise ValueError("too long")
    values: Mapping[str, Any] = json.loads(data)
    return values


def _text(value: object) -> str:
    if not isinstance(value, str) or len(value) > MAX_TEXT:
        raise ValueError("not a text")
    return value


def _count(value: object) -> int:
    if isinstance(value, bool) or not isinstance(value, int) or not 0 <= value < 2**53:
        raise ValueError("not a count")
    return value
