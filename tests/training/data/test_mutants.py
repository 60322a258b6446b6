"""Some mutants of each kind of foreign file, read where its limits hold."""

import pytest

from tests.training.data.mutants import KINDS, MOST_S, run


@pytest.mark.slow
@pytest.mark.parametrize("kind", KINDS)
def test_a_changed_file_is_read_or_refused_within_its_limits(kind: str) -> None:
    count = 60
    found = run(kind, 0, count)
    assert found["faults"] == []
    assert found["slowest"][0] < MOST_S
    assert sum(found["outcomes"].values()) == count
    assert found["outcomes"]["read"] >= 2
    assert found["outcomes"]["refused"] >= 2
