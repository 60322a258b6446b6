"""Links between documents: targets of Markdown links and images, and the anchors of headings."""

import re
from collections import Counter
from dataclasses import dataclass
from pathlib import Path

_LINK = re.compile(r"!?\[[^\]]*\]\((?P<target>[^)\s]+)\)")
_CODE = re.compile(r"```.*?```|`[^`\n]*`", re.DOTALL)
_HEADING = re.compile(r"^#{1,6} +(?P<text>.+?) *$", re.MULTILINE)


@dataclass(frozen=True)
class Link:
    """A link of a document to another file or to an anchor."""

    document: Path
    target: str

    @property
    def is_relative(self) -> bool:
        return not re.match(r"[a-z]+:", self.target)

    @property
    def problem(self) -> str | None:
        """What is wrong with it, None when it leads somewhere."""
        name, _, anchor = self.target.partition("#")
        path = (self.document.parent / name) if name else self.document
        if not path.exists():
            return f"{self.document.name}: {self.target}: no such file"
        if anchor and anchor not in anchors(path):
            return f"{self.document.name}: {self.target}: no such heading"
        return None


def links(document: Path) -> list[Link]:
    """All links of a document outside code."""
    text = _CODE.sub("", document.read_text(encoding="utf-8"))
    return [Link(document, match["target"]) for match in _LINK.finditer(text)]


def anchors(document: Path) -> set[str]:
    """The anchors that GitHub gives to headings; a repeated one gets a number."""
    text = re.sub(r"```.*?```", "", document.read_text(encoding="utf-8"), flags=re.DOTALL)
    seen: Counter[str] = Counter()
    found = set()
    for match in _HEADING.finditer(text):
        slug = re.sub(r"[^\w\- ]", "", match["text"].lower()).replace(" ", "-")
        found.add(slug if not seen[slug] else f"{slug}-{seen[slug]}")
        seen[slug] += 1
    return found
