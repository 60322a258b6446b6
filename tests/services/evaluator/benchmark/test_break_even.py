import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from cspace.errors import EvaluationError
from services.evaluator.benchmark.report import costs_in_words, worth
from services.evaluator.benchmark.summary import break_even, winning_costs
from services.evaluator.statistics import Interval

MS, US = 1e-3, 1e-6
# Time without checks and number of checks. Learned samples save 150 checks, which have to pay for 9 ms.
LEARNED, UNIFORM = (10 * MS, 50.0), (1 * MS, 200.0)
NEVER = (math.inf, math.inf)

lines = st.tuples(st.floats(0.0, 1.0, allow_subnormal=False), st.integers(0, 1000).map(float))


def costs(learned, others):
    others = np.array(others)
    low, high = winning_costs(np.array(learned[0]), np.array(learned[1]), others[:, 0], others[:, 1])
    return float(low), float(high)


@pytest.mark.parametrize(
    ("learned", "others", "expected"),
    [
        # Fewer checks win where a check costs more than what they saved.
        (LEARNED, [UNIFORM], (60 * US, math.inf)),
        # Fewer checks and less of everything else win always.
        ((1 * MS, 50.0), [(1 * MS, 200.0)], (0.0, math.inf)),
        ((0.5 * MS, 50.0), [(1 * MS, 50.0)], (0.0, math.inf)),
        # More of both wins never.
        ((10 * MS, 200.0), [(1 * MS, 50.0)], NEVER),
        ((10 * MS, 50.0), [(10 * MS, 50.0)], NEVER),
        # More checks but less else win where checks are cheap.
        (UNIFORM, [LEARNED], (0.0, 60 * US)),
        # Of several others, the dearest break-even counts: 9 ms for 30 checks.
        (LEARNED, [UNIFORM, (1 * MS, 80.0)], (300 * US, math.inf)),
        (LEARNED, [UNIFORM, (1 * MS, 40.0)], NEVER),
        (LEARNED, [UNIFORM, (20 * MS, 20.0)], (60 * US, 10 * MS / 30)),
    ],
)
def test_winning_costs_by_hand(learned, others, expected):
    assert costs(learned, others) == pytest.approx(expected)


@given(learned=lines, others=st.lists(lines, min_size=1, max_size=4), check_s=st.floats(0.0, 10.0))
def test_the_costs_are_those_at_which_it_takes_less_time_than_each(learned, others, check_s):
    low, high = costs(learned, others)
    margins = [other[0] + other[1] * check_s - learned[0] - learned[1] * check_s for other in others]
    if min(margins) > 1e-6:
        assert low <= check_s <= high
    elif min(margins) < -1e-6:
        assert not low < check_s < high


def found(learned, *others):
    return dict(break_even("x", learned, others, np.random.default_rng(0)))


def test_problems_of_one_kind_leave_no_uncertainty():
    measures = found(np.tile(LEARNED, (20, 1)), np.tile(UNIFORM, (20, 1)))
    start = measures["x_from_us"]
    assert (start.estimate, start.low, start.high) == pytest.approx((60.0, 60.0, 60.0))
    assert measures["x_typical_from_us"] == pytest.approx(60.0)
    assert math.isinf(measures["x_until_us"].estimate)


def test_a_few_hard_problems_pay_for_all_which_medians_do_not_see():
    # Nine problems save nothing; the tenth saves 3000 checks: 90 ms for 3000 checks, 30 us.
    uniform = np.stack([np.full(10, 1 * MS), np.array([50.0] * 9 + [3050.0])], axis=1)
    measures = found(np.tile(LEARNED, (10, 1)), uniform)
    start = measures["x_from_us"]
    assert start.estimate == pytest.approx(30.0)
    assert math.isinf(measures["x_typical_from_us"])
    # A problem set without the hard one, (9/10)^10 of them, never pays.
    assert math.isinf(start.high)
    assert start.low < 30.0


def test_no_problems_and_others_of_another_number_are_errors():
    nothing, some = np.empty((0, 2)), np.ones((3, 2))
    for learned, others in ((nothing, [nothing]), (some, [np.ones((2, 2))]), (some, [])):
        with pytest.raises(EvaluationError, match="same problems"):
            found(learned, *others)


def test_words_say_never_and_always_plainly():
    def words(low, high, limits=(0.0, 0.0), upper=(math.inf, math.inf)):
        return worth("x")({"x_from_us": Interval(low, *limits, 10), "x_until_us": Interval(high, *upper, 10)})

    assert words(21.0, math.inf, (17.0, math.inf)) == "above 21 us [17, never]"
    assert words(0.0, math.inf) == "always"
    assert words(0.0, math.inf, (0.0, 5.0)) == "always [0, 5]"
    assert words(math.inf, math.inf, (math.inf, math.inf)) == "never"
    assert words(math.inf, math.inf, (80.0, math.inf)) == "never [80, never]"
    assert words(0.0, 9.0, upper=(4.0, 12.0)) == "below 9 us [4, 12]"
    assert costs_in_words(2.0, 9.0) == "between 2 and 9 us"
    assert costs_in_words(45600.0, math.inf) == "above 45600 us"
    assert worth("y")({}) == "-"
