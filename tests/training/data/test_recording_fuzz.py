"""The first mutants of :mod:`tests.training.data.recording_fuzz`."""

import pytest

from tests.training.data.recording_fuzz import run
from tests.training.robots.description_fuzz import alone


@pytest.mark.parametrize("count", [1, pytest.param(100, marks=pytest.mark.slow)])
def test_a_changed_recording_is_imported_or_refused(count: int) -> None:
    found = alone(run, 0, count)
    assert found.faults == []
    assert sum(found.counts.values()) == count
    if count == 100:
        assert found.counts["refused"] > 20
        assert found.counts["1 views"] + found.counts["2 views"] > 10
