from dataclasses import replace

import pytest

from cspace.worlds import simulator_of
from cspace.worlds.planar.world import PlanarWorld
from services.evaluator.evaluation.gate import (
    Bar,
    Candidate,
    Champion,
    Comparison,
    Gain,
    PathCandidate,
    path_verdict_of,
    verdict_of,
)
from services.evaluator.statistics import Interval

PLANAR = simulator_of(PlanarWorld()).measures
GOOD = {"precision": 0.86, "coverage": 0.9, "edr": 0.2, "planning_success": 0.95}


def candidate(gain_low=0.1, real_coverage=0.98, **changes):
    return Candidate(Interval(gain_low + 0.05, gain_low, gain_low + 0.1, 60), real_coverage, GOOD | changes)


def champion(version=3, **changes):
    return Champion(version, GOOD | changes)


def recorded(*champions):
    return Bar(recorded=champions, against=champions[-1].version)


def beside(*gains, rival="the shipped model"):
    """A comparison in which each measure has these limits of its gain."""
    rows = [Gain(name, 0.5, 0.5, Interval((low + high) / 2, low, high, 60)) for name, low, high in gains]
    return Comparison(rival, tuple(rows))


SAME, BETTER, WORSE = ("coverage", -0.01, 0.01), ("precision", 0.001, 0.02), ("EDr", -0.05, -0.001)


def test_too_few_scenes_promote_nobody():
    few = Candidate(Interval(0.3, 0.3, 0.3, 4), 0.98, GOOD)
    verdict = verdict_of(few, Bar(), PLANAR)
    assert not verdict.promoted
    assert "evaluated on 4 scenes; fewer than 5 say nothing about others" in verdict.reasons
    assert verdict_of(replace(few, precision_gain=Interval(0.3, 0.3, 0.3, 5)), Bar(), PLANAR).promoted


def test_a_first_version_that_beats_uniform_and_covers_is_promoted():
    verdict = verdict_of(candidate(), Bar(), PLANAR)
    assert verdict.promoted
    assert verdict.bar.against is None
    assert any("no earlier champion" in reason for reason in verdict.reasons)


def test_a_gain_whose_interval_touches_zero_is_not_enough():
    verdict = verdict_of(candidate(gain_low=0.0), Bar(), PLANAR)
    assert not verdict.promoted
    assert any("does not beat uniform beyond the interval" in reason for reason in verdict.reasons)


@pytest.mark.parametrize(
    ("coverage", "real", "held"),
    [
        (0.784, 0.98, True),
        (0.783, 0.98, False),
        # Three joints: as many real samples cover a sixth of the space, and no constant of two joints is met.
        (0.163, 0.175, True),
        (0.126, 0.175, False),
    ],
)
def test_coverage_is_held_against_what_real_samples_reach(coverage, real, held):
    verdict = verdict_of(candidate(coverage=coverage, real_coverage=real), Bar(), PLANAR)
    assert verdict.promoted is held
    words = "at least" if held else "less than"
    assert f"coverage {coverage:.3f} is {words} 0.80 of the {real:.3f} of real samples" in verdict.reasons


def test_a_version_that_is_worse_than_a_rival_in_nothing_and_better_in_one_is_promoted():
    verdict = verdict_of(candidate(), Bar((beside(SAME, BETTER),)), PLANAR)
    assert verdict.promoted
    assert "worse than the shipped model beyond the interval: in nothing" in verdict.reasons
    assert any(
        reason.startswith("better than the shipped model beyond the interval: precision 0.5")
        for reason in verdict.reasons
    )


@pytest.mark.parametrize("gains", [(SAME,), (WORSE, BETTER), (WORSE,), (("precision", 0.0, 0.0),)])
def test_a_version_that_is_worse_in_one_or_better_in_nothing_is_refused(gains):
    assert not verdict_of(candidate(), Bar((beside(*gains),)), PLANAR).promoted
    assert not path_verdict_of(path_candidate(), Bar((beside(*gains),)), PLANAR).promoted


def test_every_rival_has_to_be_passed():
    rivals = (beside(BETTER), beside(SAME, rival="version 3, the present champion"))
    verdict = verdict_of(candidate(), Bar(rivals, against=3), PLANAR)
    assert not verdict.promoted
    assert verdict.reasons[-1] == (
        "only as good as version 3, the present champion: worse in nothing, better in nothing beyond the "
        "interval; a version has to be better in one measure"
    )


def test_a_version_that_is_worse_and_better_in_nothing_is_not_called_as_good():
    refused = verdict_of(candidate(), Bar((beside(SAME, WORSE),)), PLANAR)
    assert not any("as good as" in reason for reason in refused.reasons)
    assert "better than the shipped model beyond the interval: in nothing" in refused.reasons


def test_the_notes_are_among_the_reasons_and_decide_nothing():
    verdict = verdict_of(candidate(), Bar(notes=("not compared with anybody",)), PLANAR)
    assert verdict.promoted
    assert "not compared with anybody" in verdict.reasons


def test_a_version_within_the_margins_of_recorded_metrics_is_promoted():
    verdict = verdict_of(candidate(precision=0.845, edr=0.29), recorded(champion()), PLANAR)
    assert verdict.promoted
    # A smaller energy distance is better.
    assert verdict_of(candidate(edr=0.01), recorded(champion()), PLANAR).promoted
    assert verdict.bar.against == 3
    assert (
        "precision 0.845 is within the margin of 0.020 of the 0.860 recorded of version 3" in verdict.reasons
    )


@pytest.mark.parametrize(
    ("metric", "value"),
    [("precision", 0.83), ("coverage", 0.86), ("edr", 0.31), ("planning_success", 0.84)],
)
def test_a_version_worse_on_one_gated_metric_is_refused_with_the_numbers(metric, value):
    verdict = verdict_of(candidate(**{metric: value}), recorded(champion()), PLANAR)
    assert not verdict.promoted
    worse = [reason for reason in verdict.reasons if "is worse than" in reason]
    assert len(worse) == 1
    assert worse[0].startswith(f"{metric} {value:.3f}")


def test_many_small_steps_down_do_not_add_up():
    # Each champion was within the margin of the one before; the candidate is so of the last, not of the best.
    champions = [champion(1, precision=0.90), champion(2, precision=0.885), champion(3, precision=0.881)]
    verdict = verdict_of(candidate(precision=0.87), recorded(*champions), PLANAR)
    assert not verdict.promoted
    assert any("0.900 recorded of version 1" in reason for reason in verdict.reasons)


def test_a_gated_metric_that_was_not_measured_is_no_pass():
    metrics = {name: value for name, value in GOOD.items() if name != "planning_success"}
    verdict = verdict_of(Candidate(Interval(0.2, 0.1, 0.3, 60), 0.98, metrics), recorded(champion()), PLANAR)
    assert not verdict.promoted
    assert any("planning_success was not measured" in reason for reason in verdict.reasons)


def test_champions_without_a_metric_do_not_bind_it():
    old = Champion(1, {"precision": 0.86, "coverage": 0.9})
    assert verdict_of(candidate(), recorded(old), PLANAR).promoted


def test_share_of_coverage_and_margins_are_the_worlds():
    strict = replace(PLANAR, coverage_share=0.95)
    assert not verdict_of(candidate(), Bar(), strict).promoted
    narrow = replace(PLANAR, margins={"precision": 0.001})
    verdict = verdict_of(candidate(precision=0.858, edr=9.0), recorded(champion()), narrow)
    assert not verdict.promoted
    assert [reason for reason in verdict.reasons if "margin" in reason] == [
        "precision 0.858 is worse than the margin of 0.001 of the 0.860 recorded of version 3"
    ]


PATHS = {"planning_success": 0.95, "narrow_edge_checks_ratio": 3.0}


def path_candidate(low=1.5, uniform_success=0.9, **changes):
    saved = Interval(low + 1.0, low, low + 2.0, 30)
    return PathCandidate("narrow", saved, uniform_success, PATHS | changes)


def test_a_path_model_that_saves_checks_and_solves_as_much_is_promoted():
    verdict = path_verdict_of(path_candidate(), Bar(), PLANAR)
    assert verdict.promoted
    assert any(reason.startswith("saves edge checks in narrow problems") for reason in verdict.reasons)


@pytest.mark.parametrize(
    ("candidate", "words"),
    [
        (path_candidate(low=1.0), "does not save edge checks"),
        (path_candidate(uniform_success=0.96), "solves fewer problems than uniform samples"),
    ],
)
def test_a_path_model_that_saves_nothing_or_solves_less_is_refused(candidate, words):
    verdict = path_verdict_of(candidate, Bar(), PLANAR)
    assert not verdict.promoted
    assert any(reason.startswith(words) for reason in verdict.reasons)


@pytest.mark.parametrize(
    ("changes", "held"),
    [
        ({"narrow_edge_checks_ratio": 2.1}, True),
        ({"narrow_edge_checks_ratio": 1.9}, False),
        ({"planning_success": 0.84}, False),
    ],
)
def test_a_path_model_stays_near_the_best_of_its_champions(changes, held):
    champions = [Champion(1, PATHS), Champion(2, PATHS | {"narrow_edge_checks_ratio": 2.0})]
    verdict = path_verdict_of(path_candidate(uniform_success=0.5, **changes), recorded(*champions), PLANAR)
    assert (verdict.promoted, verdict.bar.against) == (held, 2)


def test_a_world_without_balls_that_tell_asks_for_no_coverage():
    measures = replace(PLANAR, coverage_share=None)
    collapsed = candidate(coverage=0.012)
    assert verdict_of(collapsed, Bar(), measures).promoted
    without = replace(collapsed, metrics={"precision": 0.9, "edr": 0.2})
    assert verdict_of(without, Bar(), measures).promoted
    assert not any("coverage" in reason for reason in verdict_of(without, Bar(), measures).reasons)
