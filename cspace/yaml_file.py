"""Untrusted YAML: plain values of a bounded size, and the line of each of them.

A text may hold what JSON holds: mappings with texts as keys, lists, texts, true, false, null, and finite
numbers, whole ones of at most 64 bits. It has no tags. Aliases may stand for other parts, but count as often
as they come: a few hundred bytes of them can stand for billions of values.
"""

import math
import re
from collections.abc import Hashable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import yaml

from cspace.errors import CspaceError
from cspace.files import read_bounded

MAX_BYTES, MAX_DEPTH, MAX_VALUES = 2**20, 16, 100_000
_PREFIX = "tag:yaml.org,2002:"
_KEYS = {f"{_PREFIX}{kind}" for kind in ("str", "merge")}
_KINDS = {"map", "seq", "str", "bool", "int", "float", "null"}
_LARGEST = 2**64 - 1
# Digits of the largest in binary, its sign and prefix.
_MOST_DIGITS = 67
_SHOWN = 200
_NUMBERS = "a finite number, a whole one of at most 64 bits"


class _Loader(getattr(yaml, "CSafeLoader", yaml.SafeLoader)):  # type: ignore[misc] # the C parser is optional
    """Safe, and reads the numbers of JSON as such: YAML 1.1 takes 1e-3 for a text."""


_Loader.add_implicit_resolver(
    f"{_PREFIX}float", re.compile(r"-?(?:0|[1-9]\d*)(?:\.\d+)?[eE][-+]?\d+"), list("-0123456789")
)


@dataclass(frozen=True, slots=True, eq=False)
class YamlDocument:
    """A document.

    Args:
        values: plain ones; None for an empty text.
        root: what they were made of; None for an empty text.
    """

    values: Any
    root: yaml.Node | None

    def line(self, place: Sequence[Hashable]) -> int:
        """The line, from 1, of a value, or of the last of its parents that is there."""
        node, line = self.root, 1 if self.root is None else _line(self.root)
        for step in place:
            if isinstance(node, yaml.MappingNode):
                # A key's own line, for its value may stand below.
                found = next(((key, value) for key, value in node.value if key.value == step), None)
            elif isinstance(node, yaml.SequenceNode) and isinstance(step, int) and step < len(node.value):
                found = (node.value[step], node.value[step])
            else:
                found = None
            if found is None:
                break
            line, node = _line(found[0]), found[1]
        return line


def read_yaml_file(path: Path, error: type[CspaceError]) -> YamlDocument:
    """Read a file."""
    return read_yaml(read_bounded(path, MAX_BYTES, error), str(path), error)


def read_yaml(text: bytes | str, name: str, error: type[CspaceError]) -> YamlDocument:
    """Read a text.

    Args:
        text: YAML or JSON; bytes are UTF-8.
    """
    if len(text) > MAX_BYTES:
        raise error(f"{name} is too large", expected=f"at most {MAX_BYTES} bytes", got=f"{len(text)}")
    try:
        decoded = (text.encode() if isinstance(text, str) else text).decode()
    except UnicodeError as problem:
        raise error(f"{name} is no YAML", expected="UTF-8", got=str(problem)[:_SHOWN]) from problem
    try:
        return _Reader(decoded, name, error).read()
    except yaml.YAMLError as problem:
        mark = getattr(problem, "problem_mark", None)
        # The C parser counts one more where the text ends without a newline.
        last = decoded.count("\n") + 1
        line = "" if mark is None else f":{min(mark.line + 1, last)}"
        got = getattr(problem, "problem", None) or str(problem)
        raise error(f"{name}{line} is no YAML", expected="YAML or JSON", got=got[:_SHOWN]) from problem


@dataclass(frozen=True, slots=True)
class _Reader:
    text: str
    name: str
    error: type[CspaceError]

    def read(self) -> YamlDocument:
        self._check_events()
        loader = _Loader(self.text)
        root = loader.get_single_node()
        if root is None:
            return YamlDocument(None, None)
        self._check(root, loader)
        return YamlDocument(loader.construct_document(root), root)

    def _check_events(self) -> None:
        """Refuse depth, and aliases that stand for too much, before anything is built."""
        total, parts = 0, _Parts()
        for event in yaml.parse(self.text, Loader=_Loader):
            size, height = parts.add(event)
            total += size
            if len(parts.open) + height > MAX_DEPTH:
                raise self._refused(event, "it is nested too deep", f"at most {MAX_DEPTH} levels", "more")
            if total > MAX_VALUES:
                raise self._refused(event, "it holds too many values", f"at most {MAX_VALUES}", "more")
            if isinstance(event, yaml.AliasEvent) and any(one[0] == event.anchor for one in parts.open):
                raise self._refused(event, "a part holds itself", "a tree of values", f"*{event.anchor}")

    def _check(self, node: yaml.Node, loader: Any) -> None:
        """Refuse what JSON has not."""
        kind = node.tag.removeprefix(_PREFIX)
        if kind not in _KINDS:
            expected = "what JSON has, and texts that look like dates in quotes"
            raise self._refused(node, "a value does not fit", expected, f"a value of the kind {kind}")
        if isinstance(node, yaml.MappingNode):
            seen = set()
            for key, value in node.value:
                if key.tag not in _KEYS:
                    raise self._refused(
                        key, "a key is no text", "a text, in quotes where it needs them", kind
                    )
                if key.value in seen:
                    raise self._refused(key, f"the key {key.value} stands twice", "each key once", "two")
                seen.add(key.value)
                self._check(value, loader)
        elif isinstance(node, yaml.SequenceNode):
            for value in node.value:
                self._check(value, loader)
        elif kind in ("int", "float") and not _is_number(node, loader, whole=kind == "int"):
            raise self._refused(node, "a number does not fit", _NUMBERS, node.value)

    def _refused(self, at: yaml.Node | yaml.Event, what: str, expected: str, got: str) -> CspaceError:
        where = f"{self.name}:{_line(at)}"
        return self.error(f"{where}: {what}", expected=expected, got=got[:_SHOWN])


def _line(at: yaml.Node | yaml.Event) -> int:
    return 1 if at.start_mark is None else at.start_mark.line + 1


class _Parts:
    """Sizes and heights of the parts of a document, aliases as what they stand for."""

    def __init__(self) -> None:
        # Anchor, size and height of what has not ended.
        self.open: list[tuple[str | None, int, int]] = []
        self._named: dict[str | None, tuple[int, int]] = {}

    def add(self, event: yaml.Event) -> tuple[int, int]:
        """How many values an event adds, and how many levels below those that are open."""
        if isinstance(event, yaml.CollectionStartEvent):
            self.open.append((event.anchor, 1, 1))
            return 1, 0
        if isinstance(event, yaml.CollectionEndEvent):
            anchor, size, height = self.open.pop()
            self._end(anchor, size, height)
            return 0, 0
        if isinstance(event, yaml.AliasEvent):
            # The parser refuses an alias of nothing.
            size, height = self._named.get(event.anchor, (0, 0))
            self._end(None, size, height)
            return size, height
        if isinstance(event, yaml.ScalarEvent):
            self._end(event.anchor, 1, 0)
            return 1, 0
        return 0, 0

    def _end(self, anchor: str | None, size: int, height: int) -> None:
        if anchor is not None:
            self._named[anchor] = size, height
        if self.open:
            around, so_far, highest = self.open[-1]
            self.open[-1] = around, so_far + size, max(highest, height + 1)


def _is_number(node: yaml.Node, loader: Any, *, whole: bool) -> bool:
    if whole and len(node.value) > _MOST_DIGITS:
        return False
    try:
        value = loader.construct_object(node)
    except (ValueError, OverflowError):
        return False
    return abs(value) <= _LARGEST if whole else math.isfinite(value)
