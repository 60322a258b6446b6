"""Arms whose samples are treated, beside the ones that take them as they come."""

import pytest

from services.evaluator.benchmark.arms import Group, table
from services.evaluator.benchmark.report import plain_arm, treated_table
from services.evaluator.benchmark.summary import PairedRuns

ARMS = table(["way", "other"], 1.0)
BY_NAME = {arm.name: arm for arm in ARMS}
PLAIN, CHECKED = "RRT, way, 70 %", "RRT, way, 70 %, colliding last"


@pytest.mark.parametrize(
    ("name", "plain"),
    [
        (CHECKED, PLAIN),
        ("RRT, other, 100 %, filtered", "RRT, other, 100 %"),
        ("own RRT-Connect, way, 70 %, ordered", "own RRT-Connect, way, 70 %"),
        ("own RRT-Connect, way, 100 %, ordered, colliding last", "own RRT-Connect, way, 100 %"),
        (PLAIN, None),
        ("RRT, uniform", None),
        ("RRT, way, schedule in order", None),
    ],
)
def test_the_plain_arm_differs_in_the_treatment_alone(name, plain):
    found = plain_arm(BY_NAME[name], ARMS)
    assert (found.name if found else None) == plain


def test_without_the_plain_arm_there_is_nothing_to_compare():
    assert plain_arm(BY_NAME[CHECKED], [BY_NAME[CHECKED]]) is None


def test_every_treated_arm_has_a_plain_one():
    treated = [
        arm for arm in ARMS if arm.group in (Group.FILTERED, Group.ORDERED, Group.CHECKED) and arm.sampler
    ]
    assert len(treated) == 2 * (2 + 4 + 8)
    assert all(plain_arm(arm, ARMS) is not None for arm in treated)


def test_lost_and_won_runs_are_counted_in_pairs_and_the_interval_is_over_problems(make_run, rng):
    # Within 1000 iterations: both, only the plain one, only the checked one, and only the checked one again.
    rows = [(100, 100), (900, 1100), (1500, 800), (None, 1000)]
    runs = [
        make_run(arm=arm, problem=problem, iterations=count or 1000, solved=count is not None)
        for problem, pair in enumerate(rows)
        for arm, count in zip((PLAIN, CHECKED), pair, strict=True)
    ]
    header, row = treated_table(PairedRuns(runs), [BY_NAME[PLAIN], BY_NAME[CHECKED]], rng)
    assert row[:5] == [CHECKED, PLAIN, "0.7500, 0.5000", "1 of 4", "2"]
    assert row[5].startswith("0.2500 [-0.5000, ")
    assert len(header) == len(row)
