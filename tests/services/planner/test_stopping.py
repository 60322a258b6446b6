from services.planner.ompl_adapters import StoppingRule
from services.planner.result import Reason


def test_as_many_iterations_are_allowed_as_were_asked_for():
    rule = StoppingRule(3, 100.0, clock=lambda: 0.0)
    assert [rule() for _ in range(5)] == [False, False, False, True, True]
    assert rule.iterations == 3
    assert rule.reason is Reason.ITERATION_LIMIT


def test_the_clock_starts_with_the_first_question():
    times = iter([1000.0, 1001.9, 1002.0])
    rule = StoppingRule(100, 2.0, clock=lambda: next(times))
    assert [rule(), rule(), rule()] == [False, False, True]
    assert rule.reason is Reason.TIME_LIMIT


def test_sampled_states_are_counted_where_a_question_is_no_iteration():
    counts = iter([0, 0, 100, 205, 205])
    rule = StoppingRule(200, 100.0, clock=lambda: 0.0, sample_count=lambda: next(counts))
    assert [rule() for _ in range(4)] == [False, False, False, True]
    assert rule.iterations == 205
    assert rule.reason is Reason.ITERATION_LIMIT


def test_a_rule_that_ended_a_search_never_takes_it_back():
    times = iter([0.0, 5.0, 1.0])
    rule = StoppingRule(100, 2.0, clock=lambda: next(times))
    assert [rule(), rule(), rule()] == [False, True, True]
