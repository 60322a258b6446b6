"""Versions, references, runs and parameters as values; nothing here imports MLflow, which takes seconds."""

import json
import re
from collections.abc import Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass
from typing import Annotated, Any, ClassVar, Literal

from pydantic import ConfigDict, Field

from cspace.errors import ConfigError, InputError

# A version may come from a file or from another process.
_Text = Annotated[str, Field(max_length=20_000)]
_Count = Annotated[int, Field(ge=0, lt=2**53)]

PRETRAINED = "pretrained"
# Shipped models and their folders beside the API's code.
SHIPPED = {PRETRAINED: "pretrained", f"{PRETRAINED}-panda": "pretrained_panda"}

# Names become folders of the cache: no separators, no leading dot.
_NAME = r"[A-Za-z0-9][A-Za-z0-9._-]{0,99}"
_REFERENCE = re.compile(
    rf"(?P<name>{_NAME})(?:@(?P<alias>[A-Za-z0-9_-]{{1,100}})|/(?P<version>[1-9][0-9]{{0,8}}))?", re.ASCII
)


def is_model_name(text: str) -> bool:
    """Whether a text can be a model's name, and so a folder's of the cache."""
    return re.fullmatch(_NAME, text, re.ASCII) is not None


@dataclass(frozen=True)
class ModelVersion:
    """One version of a registered model.

    ``digest`` is the SHA-256 of the bundle's ``SHA256SUMS``, empty for a version that somebody else
    registered; ``created_ms`` counts from 1970-01-01 UTC.
    """

    __pydantic_config__: ClassVar = ConfigDict(extra="forbid", strict=True, revalidate_instances="always")

    name: _Text
    number: _Count
    run_id: _Text
    digest: _Text
    aliases: tuple[_Text, ...]
    tags: Mapping[_Text, _Text]
    created_ms: _Count

    def __str__(self) -> str:
        return f"{self.name}/{self.number}"


@dataclass(frozen=True, slots=True)
class ModelReference:
    """A model as users name it: ``name``, ``name@alias``, ``name/version`` or ``pretrained``."""

    name: str
    alias: str | None = None
    version: int | None = None

    @classmethod
    def parse(cls, text: str) -> "ModelReference":
        """Read a reference; raises InputError."""
        match = _REFERENCE.fullmatch(text)
        if match is None:
            raise InputError(
                "model is not a reference",
                expected="name, name@alias, name/version or pretrained",
                got=repr(text)[:200],
            )
        version = match["version"]
        return cls(match["name"], match["alias"], None if version is None else int(version))

    @classmethod
    def parse_version(
        cls, text: str, what: str, expected: str = "name@alias or name/version"
    ) -> "ModelReference":
        """Read a reference that names an alias or a version; raises ConfigError with these words."""
        with suppress(InputError):
            found = cls.parse(text)
            if not found.is_bare:
                return found
        raise ConfigError(what, expected=expected, got=repr(text))

    @property
    def is_bare(self) -> bool:
        """Whether neither alias nor version was given; the champion is meant."""
        return self.alias is None and self.version is None

    def __str__(self) -> str:
        if self.version is not None:
            return f"{self.name}/{self.version}"
        return self.name if self.alias is None else f"{self.name}@{self.alias}"


RunStatus = Literal["FINISHED", "FAILED", "KILLED"]
ID, ID_LENGTH = "{id}", 6
"""In a run's name, and how much of the run's id stands there instead."""


# MLflow's limits of a parameter's name and value.
_MAX_NAME, _MAX_VALUE = 250, 6000
_FORBIDDEN = re.compile(r"[^\w\-. /:]")


def flatten(params: Mapping[str, Any]) -> dict[str, str]:
    """Nested mappings as MLflow's parameters: ``{"critic": {"steps": 5}}`` is ``{"critic.steps": "5"}``."""
    return {_FORBIDDEN.sub("_", name)[:_MAX_NAME]: _text(value) for name, value in _leaves("", params)}


def _leaves(prefix: str, params: Mapping[str, Any]) -> Iterator[tuple[str, Any]]:
    for key, value in params.items():
        name = f"{prefix}.{key}" if prefix else str(key)
        if isinstance(value, Mapping) and value:
            yield from _leaves(name, value)
        else:
            yield name, value


def _text(value: Any) -> str:
    text = json.dumps(value, default=str) if isinstance(value, list | tuple | Mapping) else str(value)
    return text if len(text) <= _MAX_VALUE else text[: _MAX_VALUE - 3] + "..."
