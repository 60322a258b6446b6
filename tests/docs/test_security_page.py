"""The threat model names tests that exist, for each of its lines."""

import re

import pytest

from tests.docs.blocks import ROOT

_TEST = re.compile(r"`(test_\w+\.py)::(test_\w+)`")
TEXT = (ROOT / "docs" / "security.md").read_text(encoding="utf-8")
LINES = [line for line in TEXT.splitlines() if re.match(r"\| API\d", line)]
ATTACKERS = [
    line for line in TEXT.splitlines() if re.match(r"\| (a|an) (page|client|writer|malicious)", line)
]


def exists(file: str, name: str) -> bool:
    found = (ROOT / "tests").rglob(file)
    return any(f"def {name}(" in path.read_text(encoding="utf-8") for path in found)


@pytest.mark.parametrize("line", [*LINES, *ATTACKERS], ids=lambda line: "-".join(line.split()[1:5]))
def test_every_risk_says_what_holds_what_does_not_and_which_tests_show_it(line: str) -> None:
    _, _, holds, lacks, shown, _ = (cell.strip() for cell in line.split("|"))
    assert holds
    assert lacks
    assert _TEST.findall(shown)


def test_every_test_that_is_named_exists() -> None:
    assert [found for found in _TEST.findall(TEXT) if not exists(*found)] == []
    assert not exists("test_guards.py", "test_no_such_test")
