import re
from pathlib import Path

import pytest

from tests.docs.blocks import ROOT, documents
from tests.docs.links import links

NAMES = [str(path.relative_to(ROOT)) for path in documents()]
# A name in code that ends in one of these, or in a slash, is a path of the project.
_PATH = re.compile(
    r"`((?:cspace|clients|training|services|inference_api|tests|docs|docker|benchmarks)/[\w./-]*)`"
)


@pytest.mark.parametrize("name", NAMES)
def test_every_relative_link_leads_to_a_file_of_the_repository_and_a_heading(name: str) -> None:
    found = [link for link in links(ROOT / name) if link.is_relative]
    assert [link.problem for link in found if link.problem] == []
    targets = [(ROOT / name).parent / link.target.partition("#")[0] for link in found]
    assert [path for path in targets if not path.resolve().is_relative_to(ROOT)] == []


@pytest.mark.parametrize("name", NAMES)
def test_every_path_in_the_text_exists(name: str) -> None:
    text = re.sub(r"```.*?```", "", (ROOT / name).read_text(encoding="utf-8"), flags=re.DOTALL)
    assert [path for path in _PATH.findall(text) if not (ROOT / path).exists()] == []


def test_every_page_of_the_documentation_can_be_reached_from_its_index() -> None:
    reached, waiting = set[Path](), [ROOT / "docs" / "index.md"]
    while waiting:
        page = waiting.pop()
        if page in reached or page.suffix != ".md" or not page.is_file():
            continue
        reached.add(page)
        waiting += [
            (page.parent / link.target.partition("#")[0]).resolve()
            for link in links(page)
            if link.is_relative
        ]
    assert sorted(set((ROOT / "docs").rglob("*.md")) - reached) == []


def test_a_link_to_a_missing_file_or_heading_is_found(tmp_path: Path) -> None:
    page = tmp_path / "page.md"
    page.write_text(
        "# One heading\n[a](gone.md) [b](#one-heading) [c](#two) `[d](code.md)`\n", encoding="utf-8"
    )
    problems = [link.problem for link in links(page)]
    assert problems == ["page.md: gone.md: no such file", None, "page.md: #two: no such heading"]
