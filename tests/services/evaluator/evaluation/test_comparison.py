"""Paired gains by hand: their sign, what is paired with what, what is served."""

from dataclasses import replace

import numpy as np
import pytest

from cspace.errors import EvaluationError
from services.evaluator.evaluation.gate import compare_paths, compare_samplers
from services.evaluator.measures.occupancy import SceneOccupancy
from services.evaluator.measures.planning import PlanningTrial, RunOutcome
from services.evaluator.measures.sample_quality import SampleQuality, SceneQuality

UNIFORM = SampleQuality(0.7, 0.95, 1.0, 0.8, 0.99)
HEAD = SceneOccupancy(0.99, 1, 1, (1,), (1.0,), (1,), 0.9)


def quality(precision, coverage=0.9, energy=0.1):
    return SampleQuality(precision, coverage, energy, 0.9, 0.9)


def scene(index, drawn, served=None, *, head=False, family="uniform"):
    occupancy = HEAD if head or served is not None else None
    return SceneQuality(index, drawn, UNIFORM, UNIFORM, served, occupancy, family)


def run(*, success=True, checks=100):
    return RunOutcome(success, 10, checks, 0.1, 1.0 if success else None, 3, "")


def trial(index, learned, confident=None, *, family="narrow", seed=1):
    return PlanningTrial(family, index, seed, run(), learned, 0.1, confident)


def gains(ours, theirs, compare=compare_samplers, *more):
    found = compare("a rival", ours, theirs, *more, np.random.default_rng(0))
    assert found.rival == "a rival"
    return {gain.name: gain for gain in found.gains}


def test_gains_are_paired_by_scene_whatever_the_order_and_smaller_energy_is_better():
    levels = np.linspace(0.5, 0.9, 20)
    ours = [scene(i, quality(level + 0.01, level, 0.3)) for i, level in enumerate(levels)]
    theirs = [scene(i, quality(level, level + 0.01, 0.4)) for i, level in enumerate(levels)]
    found = gains(ours, theirs[::-1])
    assert list(found) == ["precision", "coverage", "EDr"]
    # Scenes differ by far more than the models do: unpaired intervals would tell nothing.
    assert found["precision"].better
    assert found["precision"].gain.low == pytest.approx(0.01)
    assert found["coverage"].worse
    assert (found["EDr"].ours, found["EDr"].theirs) == (pytest.approx(0.3), pytest.approx(0.4))
    assert found["EDr"].gain.estimate == pytest.approx(0.1)
    assert found["EDr"].better


def test_equal_models_are_neither_better_nor_worse():
    rows = [scene(i, quality(0.9)) for i in range(5)]
    assert not any(gain.better or gain.worse for gain in gains(rows, rows).values())


def test_only_uniform_scenes_that_both_have_count():
    ours = [scene(0, quality(0.9)), scene(1, quality(0.1)), scene(0, quality(0.2), family="narrow")]
    assert gains(ours, [scene(0, quality(0.8))])["precision"].ours == 0.9
    with pytest.raises(EvaluationError):
        gains(ours, [scene(7, quality(0.8))])


def test_a_head_makes_every_measure_count_twice_and_without_one_the_draw_is_served():
    ours = [scene(i, quality(0.98)) for i in range(9)]
    theirs = [scene(i, quality(0.9), quality(0.999)) for i in range(9)]
    found = gains(ours, theirs)
    assert found["precision"].better
    assert found["precision as served"].worse
    assert found["precision as served"].ours == pytest.approx(0.98)
    assert {"coverage as served", "EDr as served"} <= found.keys()


def test_a_head_that_lets_too_few_pass_is_worse_than_one_that_does_not():
    ours = [scene(i, quality(0.9), None if i % 2 else quality(0.99), head=True) for i in range(20)]
    theirs = [scene(i, quality(0.9), quality(0.98)) for i in range(20)]
    found = gains(ours, theirs)
    assert found["share of scenes with enough samples as served"].worse
    assert found["precision as served"].better
    assert found["precision as served"].gain.count == 10
    never = [scene(i, quality(0.9), head=True) for i in range(20)]
    assert "precision as served" not in gains(never, theirs)


def test_success_counts_a_problem_once_and_as_served_by_the_filtered_run():
    scenes = [scene(0, quality(0.9), quality(0.99))]
    failed = run(success=False)
    ours = [trial(i, run(), failed, seed=seed) for i in range(10) for seed in (1, 2)]
    theirs = [trial(i, run(), run(), seed=seed) for i in range(10) for seed in (1, 2)]
    found = gains(scenes + ours, scenes + theirs)
    assert found["planning success"].gain.count == 10
    assert not found["planning success"].worse
    assert (found["planning success as served"].ours, found["planning success as served"].worse) == (
        0.0,
        True,
    )


def test_path_models_are_compared_by_success_and_the_checks_they_need_where_it_tells():
    ours = [trial(i, run(checks=50)) for i in range(10)]
    ours += [trial(i, run(checks=900), family="uniform") for i in range(10)]
    theirs = [replace(row, learned=run()) for row in ours]
    found = gains(ours, theirs, compare_paths, "narrow")
    checks = found["median edge checks in narrow problems"]
    assert (checks.ours, checks.theirs, checks.gain.estimate) == (50.0, 100.0, 0.5)
    assert checks.better
    # A run that fails has needed as many as the worst.
    failing = [replace(row, learned=run(success=False, checks=1)) for row in ours]
    found = gains(failing, theirs, compare_paths, "narrow")
    assert not found["median edge checks in narrow problems"].better
    assert found["planning success"].worse
