"""The doctor on a small set of simulated views; benchmarks/spatial/doctor.py measures it on a large one."""

import pytest

from benchmarks.spatial.doctor import EXACT, KINDS, is_found, measured
from cspace.simulator import Split
from cspace.worlds import examples

WORLD = examples()["panda"]


@pytest.mark.slow
def test_of_simulated_views_most_mistakes_are_found_and_few_alarms_are_false():
    found, alarms, _ = measured(WORLD, 40, KINDS, clean=True, split=Split.VALIDATION, seed=3)
    hits = [is_found(row, KINDS[name]) for name, rows in found.items() for row in rows]
    assert (len(hits), len(alarms)) == (20, 20)
    assert sum(hits) >= 18
    assert sum(map(bool, alarms)) <= 1
    exact, _, _ = measured(WORLD, 10, EXACT, clean=False, split=Split.VALIDATION, seed=3)
    assert sum(is_found(row, EXACT[name]) for name, rows in exact.items() for row in rows) >= 9
