import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from cspace.errors import EvaluationError
from services.evaluator.benchmark.summary import (
    NEVER,
    BreakEven,
    Spent,
    TimeLine,
    WinningCosts,
    break_even,
    costs_in_words,
    in_words,
    winning_costs,
)

MS, US = 1e-3, 1e-6
# 10 ms of request and 50 checks against nothing but 200 checks: the 150 that are saved have to pay for 9 ms.
LEARNED, UNIFORM = TimeLine(10 * MS, 50.0), TimeLine(1 * MS, 200.0)

lines = st.builds(
    TimeLine,
    st.floats(0.0, 1.0, allow_subnormal=False),
    st.integers(0, 1000).map(float),
)


def test_fewer_checks_win_where_a_check_costs_more_than_what_they_saved():
    found = winning_costs(LEARNED, [UNIFORM])
    assert found.low_s == pytest.approx(60 * US)
    assert math.isinf(found.high_s)
    assert LEARNED.total_s(60 * US) == pytest.approx(UNIFORM.total_s(60 * US)) == pytest.approx(13 * MS)


def test_fewer_checks_and_less_of_everything_else_win_always():
    assert winning_costs(TimeLine(1 * MS, 50.0), [TimeLine(1 * MS, 200.0)]).always
    assert winning_costs(TimeLine(0.5 * MS, 50.0), [TimeLine(1 * MS, 50.0)]).always


def test_more_of_both_wins_never():
    assert winning_costs(TimeLine(10 * MS, 200.0), [TimeLine(1 * MS, 50.0)]) is NEVER
    assert winning_costs(TimeLine(10 * MS, 50.0), [TimeLine(10 * MS, 50.0)]).never


def test_more_checks_but_less_else_win_where_checks_are_cheap():
    found = winning_costs(UNIFORM, [LEARNED])
    assert (found.low_s, found.high_s) == (0.0, pytest.approx(60 * US))


def test_against_several_the_dearest_break_even_counts():
    # 1 ms and 80 checks: 9 ms for 30 checks, 300 us.
    better = TimeLine(1 * MS, 80.0)
    assert winning_costs(LEARNED, [UNIFORM, better]).low_s == pytest.approx(300 * US)
    assert winning_costs(LEARNED, [UNIFORM, TimeLine(1 * MS, 40.0)]).never
    # 20 ms and 20 checks: beaten below 10 ms / 30.
    between = winning_costs(LEARNED, [UNIFORM, TimeLine(20 * MS, 20.0)])
    assert (between.low_s, between.high_s) == (pytest.approx(60 * US), pytest.approx(10 * MS / 30))


@given(learned=lines, others=st.lists(lines, min_size=1, max_size=4), check_s=st.floats(0.0, 10.0))
def test_the_costs_are_those_at_which_it_takes_less_time_than_each(learned, others, check_s):
    found = winning_costs(learned, others)
    margins = [other.total_s(check_s) - learned.total_s(check_s) for other in others]
    if min(margins) > 1e-6:
        assert found.low_s <= check_s <= found.high_s
        assert not found.never
    elif min(margins) < -1e-6:
        assert not found.low_s < check_s < found.high_s


def test_sums_are_over_problems_and_a_single_kind_of_problem_leaves_no_doubt():
    learned = Spent(np.full(20, 10 * MS), np.full(20, 50.0))
    uniform = Spent(np.full(20, 1 * MS), np.full(20, 200.0))
    found = break_even(learned, [uniform], np.random.default_rng(0), resamples=50)
    assert found.costs.low_s == pytest.approx(60 * US)
    assert found.low_s == pytest.approx((60 * US, 60 * US))
    assert found.typical.low_s == pytest.approx(60 * US)
    assert found.never_share == 0.0


def test_a_few_hard_problems_pay_for_all_which_medians_do_not_see():
    # Nine problems save nothing; the tenth saves 3000 checks: 90 ms for 3000 checks, 30 us.
    learned = Spent(np.full(10, 10 * MS), np.full(10, 50.0))
    uniform = Spent(np.full(10, 1 * MS), np.array([50.0] * 9 + [3050.0]))
    found = break_even(learned, [uniform], np.random.default_rng(0))
    assert found.costs.low_s == pytest.approx(30 * US)
    assert found.typical.never
    # A problem set without the hard one, (9/10)^10 of them, never pays.
    assert found.never_share == pytest.approx(0.9**10, abs=0.03)
    assert math.isinf(found.low_s[1])
    assert found.low_s[0] < 30 * US


def test_no_problems_and_others_of_another_number_are_errors():
    nothing, some = Spent(np.empty(0), np.empty(0)), Spent(np.ones(3), np.ones(3))
    rng = np.random.default_rng(0)
    for learned, others in ((nothing, [nothing]), (some, [Spent(np.ones(2), np.ones(2))])):
        with pytest.raises(EvaluationError, match="same problems"):
            break_even(learned, others, rng)
    with pytest.raises(EvaluationError, match="nothing to compare"):
        winning_costs(LEARNED, [])


def test_words_say_never_and_always_plainly():
    def words(low, high, limits=(0.0, 0.0), upper=(math.inf, math.inf)):
        costs = WinningCosts(low, high)
        return in_words(BreakEven(costs, limits, upper, costs, 0.0))

    assert words(21 * US, math.inf, (17 * US, math.inf)) == "above 21 us [17, never]"
    assert words(0.0, math.inf) == "always"
    assert words(0.0, math.inf, (0.0, 5 * US)) == "always [0, 5]"
    assert words(math.inf, math.inf, (math.inf, math.inf)) == "never"
    assert words(math.inf, math.inf, (80 * US, math.inf)) == "never [80, never]"
    assert words(0.0, 9 * US, upper=(4 * US, 12 * US)) == "below 9 us [4, 12]"
    assert costs_in_words(WinningCosts(2 * US, 9 * US)) == "between 2 and 9 us"
    assert costs_in_words(WinningCosts(0.0456, math.inf)) == "above 45600 us"
