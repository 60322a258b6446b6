"""The points of a grid over configuration keys, each with a name of its own."""

import hashlib
import itertools
import json
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import yaml

from cspace.errors import ConfigError

EXAMPLE = "--grid 'clusters.count=[1, 2, 4]'"


@dataclass(frozen=True, slots=True)
class Axis:
    """One key and the values that it takes."""

    key: str
    values: tuple[Any, ...]


@dataclass(frozen=True, slots=True)
class Point:
    """One choice of values.

    Args:
        settings: keys with their values, in the order of the axes.
    """

    settings: tuple[tuple[str, Any], ...]

    def __hash__(self) -> int:
        # Values may be lists and mappings, as ``--set`` takes them.
        return hash(self.key)

    @property
    def overrides(self) -> list[str]:
        """The settings as ``--set`` takes them."""
        return [f"{key}={json.dumps(value)}" for key, value in self.settings]

    @property
    def key(self) -> str:
        """Eight hex digits that change with the settings, not with the order of the axes."""
        return hashlib.sha256("\n".join(sorted(self.overrides)).encode()).hexdigest()[:8]

    @property
    def title(self) -> str:
        """For people."""
        return ", ".join(self.overrides)


def axis(text: str) -> Axis:
    """The axis of ``KEY=[VALUE, ...]``.

    Raises:
        ConfigError: it is none, its list is empty, or a value stands there twice.
    """
    key, separator, listed = text.partition("=")
    try:
        values = yaml.safe_load(listed) if separator else None
    except yaml.YAMLError:
        values = None
    if not key.strip() or not isinstance(values, list) or not values:
        raise ConfigError("a grid does not fit", expected="KEY=[VALUE, ...]", got=repr(text), remedy=EXAMPLE)
    if len({json.dumps(value) for value in values}) < len(values):
        raise ConfigError("a grid has a value twice", expected="different values", got=repr(text))
    return Axis(key.strip(), tuple(values))


def points(axes: Sequence[Axis]) -> list[Point]:
    """Every combination, the last axis varying fastest.

    Raises:
        ConfigError: no axes, or two of the same key.
    """
    keys = [one.key for one in axes]
    if not keys or len(set(keys)) < len(keys):
        raise ConfigError(
            "the grid does not fit",
            expected="one axis or more, each with a key of its own",
            got=", ".join(keys) or "none",
            remedy=EXAMPLE,
        )
    return [
        Point(tuple(zip(keys, values, strict=True)))
        for values in itertools.product(*(one.values for one in axes))
    ]
