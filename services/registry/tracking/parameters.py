"""Parameters as MLflow keeps them: flat names, text values, bounded lengths."""

import json
import re
from collections.abc import Iterator, Mapping
from typing import Any

MAX_NAME = 250
MAX_VALUE = 6000
_FORBIDDEN = re.compile(r"[^\w\-. /:]")


def flatten(params: Mapping[str, Any]) -> dict[str, str]:
    """Nested mappings as dotted names and text: ``{"critic": {"steps": 5}}`` is ``{"critic.steps": "5"}``.

    Sequences are written as JSON. A value longer than MLflow keeps is cut, and ends in dots.
    """
    return {_name(name): _text(value) for name, value in _leaves("", params)}


def _leaves(prefix: str, params: Mapping[str, Any]) -> Iterator[tuple[str, Any]]:
    for key, value in params.items():
        name = f"{prefix}.{key}" if prefix else str(key)
        if isinstance(value, Mapping) and value:
            yield from _leaves(name, value)
        else:
            yield name, value


def _name(name: str) -> str:
    return _FORBIDDEN.sub("_", name)[:MAX_NAME]


def _text(value: Any) -> str:
    text = json.dumps(value, default=str) if isinstance(value, list | tuple | Mapping) else str(value)
    return text if len(text) <= MAX_VALUE else text[: MAX_VALUE - 3] + "..."
