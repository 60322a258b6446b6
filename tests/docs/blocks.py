"""The code blocks of the documents and what becomes of each.

A shell block says on the line above its fence what runs it, in a comment that readers do not see:

| comment | what runs it |
|---|---|
| ``<!-- run: static -->`` | the fast tests, as it stands |
| ``<!-- run: static slow -->`` | the same, by the slow tests |
| ``<!-- run: api -->`` | the fast tests, against an inference API with a tiny model |
| ``<!-- run: make -->`` | the fast tests, each line as ``make --dry-run`` |
| ``<!-- run: stack -->`` | the e2e tests, in the order of the document, against all services |
| ``<!-- run: stack slow -->`` | the same, left out of the sample that CI takes |
| ``<!-- run: elsewhere FILE -->`` | a test in FILE, which holds every word of ``words: ...`` after it |

Python blocks run in the fast tests, C++ blocks where a compiler and libcurl are, JSON blocks are parsed, text
blocks show what something prints.
"""

import re
from dataclasses import dataclass
from enum import StrEnum
from pathlib import Path

ROOT = Path(__file__).parents[2]

_FENCE = re.compile(r"^( *)(`{3,}|~{3,})(.*)$")
_MARK = re.compile(r"^ *<!-- run: (?P<kind>[a-z]+)(?: (?P<rest>.*?))? -->$")


class Kind(StrEnum):
    PYTHON = "python"
    CPP = "cpp"
    JSON = "json"
    TEXT = "text"
    STATIC = "static"
    API = "api"
    MAKE = "make"
    STACK = "stack"
    ELSEWHERE = "elsewhere"


BY_LANGUAGE = {"python": Kind.PYTHON, "cpp": Kind.CPP, "json": Kind.JSON, "text": Kind.TEXT}
OF_SHELL = (Kind.STATIC, Kind.API, Kind.MAKE, Kind.STACK, Kind.ELSEWHERE)


@dataclass(frozen=True)
class Block:
    """A code block; ``line`` is that of its fence, from 1; ``rest`` follows the kind in its mark."""

    document: Path
    line: int
    language: str
    source: str
    mark: str | None
    rest: str

    @property
    def kind(self) -> Kind | None:
        """What becomes of it, None when nobody knows."""
        if self.language != "bash":
            return BY_LANGUAGE.get(self.language) if self.mark is None else None
        return next((kind for kind in OF_SHELL if kind == self.mark), None)

    @property
    def name(self) -> str:
        return f"{self.document.relative_to(ROOT)}:{self.line}"

    @property
    def commands(self) -> list[str]:
        """Lines that are neither empty nor comments, continued ones joined."""
        joined = self.source.replace("\\\n", " ")
        lines = (line.strip() for line in joined.splitlines())
        return [line for line in lines if line and not line.startswith("#")]


def documents() -> list[Path]:
    """All documents that readers see, in a fixed order."""
    return [*sorted(ROOT.glob("*.md")), *sorted((ROOT / "docs").rglob("*.md"))]


def blocks(document: Path) -> list[Block]:
    """The code blocks of one document, in order."""
    found: list[Block] = []
    lines = document.read_text(encoding="utf-8").splitlines()
    at = 0
    while at < len(lines):
        opening = _FENCE.match(lines[at])
        if opening is None:
            at += 1
            continue
        end = _end(lines, at, opening[2])
        mark = _MARK.match(lines[at - 1]) if at else None
        found.append(
            Block(
                document,
                at + 1,
                opening[3].strip(),
                "\n".join(line.removeprefix(opening[1]) for line in lines[at + 1 : end]) + "\n",
                None if mark is None else mark["kind"],
                "" if mark is None else mark["rest"] or "",
            )
        )
        at = end + 1
    return found


def all_blocks(*kinds: Kind) -> list[Block]:
    """The blocks of all documents, or those of some kinds."""
    found = [block for document in documents() for block in blocks(document)]
    return [block for block in found if block.kind in kinds] if kinds else found


def _end(lines: list[str], opening: int, fence: str) -> int:
    for at in range(opening + 1, len(lines)):
        closing = _FENCE.match(lines[at])
        if closing and closing[2].startswith(fence) and not closing[3].strip():
            return at
    raise ValueError(f"the block in line {opening + 1} does not end")
