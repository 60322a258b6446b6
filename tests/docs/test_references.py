"""Names of code in the documents: ``module.name`` in the documents must be importable."""

import importlib
import re

import pytest

from tests.docs.blocks import ROOT

_NAME = re.compile(r"`((?:cspace|cspace_client|training|services|inference_api)(?:\.\w+)+)`")
PAGES = sorted((ROOT / "docs").rglob("*.md"))


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_every_dotted_name_of_the_code_exists(page) -> None:  # type: ignore[no-untyped-def]
    names = sorted(set(_NAME.findall(page.read_text(encoding="utf-8"))))
    assert [name for name in names if not _exists(name)] == []


def test_the_page_of_the_paper_names_code() -> None:
    assert len(_NAME.findall((ROOT / "docs" / "paper.md").read_text(encoding="utf-8"))) > 20


def test_a_name_that_is_gone_is_found() -> None:
    assert _exists("cspace.space.wrap")
    assert not _exists("cspace.space.no_such_function")


def _exists(name: str) -> bool:
    parts = name.split(".")
    for cut in range(len(parts), 0, -1):
        try:
            found = importlib.import_module(".".join(parts[:cut]))
        except ModuleNotFoundError:
            continue
        for attribute in parts[cut:]:
            if not hasattr(found, attribute):
                return False
            found = getattr(found, attribute)
        return True
    return False
