"""The threat model names tests that exist, for each of its lines."""

import re

import pytest

from tests.docs.blocks import ROOT

_TEST = re.compile(r"`(test_\w+\.py)::(test_\w+)`")
TEXT = (ROOT / "docs" / "security.md").read_text(encoding="utf-8")
LINES = [line for line in TEXT.splitlines() if re.match(r"\| API\d", line)]


def exists(file: str, name: str) -> bool:
    path = ROOT / "tests" / "inference_api" / file
    return path.is_file() and f"def {name}(" in path.read_text(encoding="utf-8")


def test_the_ten_risks_are_there_in_order() -> None:
    assert [line.split()[1] for line in LINES] == [f"API{number}" for number in range(1, 11)]


@pytest.mark.parametrize("line", LINES, ids=lambda line: line.split()[1])
def test_every_risk_says_what_holds_what_does_not_and_which_tests_show_it(line: str) -> None:
    _, _, holds, lacks, shown, _ = (cell.strip() for cell in line.split("|"))
    assert holds
    assert lacks
    assert _TEST.findall(shown)


def test_every_test_that_is_named_exists() -> None:
    assert [found for found in _TEST.findall(TEXT) if not exists(*found)] == []
    assert not exists("test_guards.py", "test_no_such_test")
