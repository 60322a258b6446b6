"""The first mutants of each kind of :mod:`tests.training.robots.description_fuzz`."""

import pytest

from tests.training.robots.description_fuzz import MUTANTS, alone, run


@pytest.mark.parametrize("kind", MUTANTS)
@pytest.mark.parametrize("count", [3, pytest.param(100, marks=pytest.mark.slow)])
def test_a_changed_description_is_read_rightly_or_refused(kind: str, count: int) -> None:
    pytest.importorskip("pinocchio", reason="needs the extra spatial")
    found = alone(run, kind, 0, count)
    assert found.faults == []
    assert sum(found.counts.values()) == count
    if count == 100:
        assert found.counts["refused"] > 20
        assert found.counts["an arm"] + found.counts["an arm as Pinocchio's"] > 10
