"""Untrusted YAML: plain values of a text of a bounded size."""

import re
from pathlib import Path
from typing import Any

import yaml

from cspace.errors import CspaceError
from cspace.files import read_bounded

# Aliases can stand for parts with aliases: with so many, for e^(20 / e) or 1,600 times the text.
MAX_BYTES, MAX_DEPTH, MAX_ALIASES = 2**20, 32, 20


class _Loader(getattr(yaml, "CSafeLoader", yaml.SafeLoader)):  # type: ignore[misc] # the C parser is optional
    """Safe, and reads the numbers of JSON as such: YAML 1.1 takes 1e-3 for a text."""


_Loader.add_implicit_resolver(
    "tag:yaml.org,2002:float", re.compile(r"-?(?:0|[1-9]\d*)(?:\.\d+)?[eE][-+]?\d+"), list("-0123456789")
)


def read_yaml_file(path: Path, error: type[CspaceError]) -> Any:
    """The values of a file, as :func:`read_yaml` gives them."""
    return read_yaml(read_bounded(path, MAX_BYTES, error), str(path), error)


def read_yaml(text: bytes | str, name: str, error: type[CspaceError]) -> Any:
    """The values of a text, YAML or JSON, of at most 1 MiB; None where it is empty."""
    if len(text) > MAX_BYTES:
        raise error(f"{name} is too large", expected=f"at most {MAX_BYTES} bytes", got=f"{len(text)}")
    opened: list[str | None] = []
    aliases = 0
    try:
        for event in yaml.parse(text, Loader=_Loader):
            if isinstance(event, yaml.CollectionStartEvent):
                opened.append(event.anchor)
            elif isinstance(event, yaml.CollectionEndEvent):
                opened.pop()
            elif isinstance(event, yaml.AliasEvent):
                aliases += 1
            holds_itself = isinstance(event, yaml.AliasEvent) and event.anchor in opened
            # The C parser ends the process where a text is nested deeper than its stack.
            if len(opened) > MAX_DEPTH or aliases > MAX_ALIASES or holds_itself:
                raise error(
                    f"{name} is nested too deep",
                    expected=f"at most {MAX_DEPTH} levels and {MAX_ALIASES} aliases",
                )
        return yaml.load(text, Loader=_Loader)  # noqa: S506 - a safe one
    except (yaml.YAMLError, RecursionError, ValueError) as problem:
        if isinstance(problem, error):
            raise
        raise error(f"{name} is no YAML", expected="YAML or JSON", got=str(problem)[:200]) from problem
