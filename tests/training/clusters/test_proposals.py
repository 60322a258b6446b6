"""The rule by which a bundle's proposals are mixed: the least time among what is as good as the generator."""

import itertools
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from cspace.bundle import Bundle
from tests.bundles import write_tiny_bundle
from training.clusters.calibration import Scored
from training.clusters.proposals import (
    SAMPLED,
    Costs,
    choose_proposals,
    evaluate,
    first_turn,
    proposal_costs,
    proposal_pools,
)

PRETRAINED = Path(__file__).parents[3] / "inference_api" / "pretrained"
THRESHOLDS = (0.5, 0.7)
# A generator that costs twice what the head costs, as that of the plane does.
COSTS = Costs(learned_s=5e-6, uniform_s=0.1e-6, head_s=2.5e-6)


@pytest.fixture(scope="module")
def drawn(tmp_path_factory):
    """Three validation scenes, their truth, and uniform configurations of two streams."""
    bundle = Bundle.load(write_tiny_bundle(tmp_path_factory.mktemp("tiny") / "bundle", validity=True))
    return proposal_pools(bundle, bundle.spec.world, 3)


def pools(drawn, learned_right=1.0, uniform_right=1.0):
    """A generator that is free in nearly all it draws, and a head that takes so many of the free for free."""
    found = []
    for pool in drawn:
        rng = np.random.default_rng(len(found))
        scene = pool.scene
        learned = scene.space.to_float32(scene.free(SAMPLED, rng))
        free = scene.checker.valid_batch(pool.uniform)
        found.append(
            replace(
                pool,
                learned=learned,
                learned_scored=Scored(np.full(SAMPLED, 0.9), rng.random(SAMPLED) < learned_right),
                uniform_scored=Scored(
                    np.where(free, 0.9, np.where(rng.random(SAMPLED) < uniform_right, 0.1, 0.6)), free
                ),
            )
        )
    return found


def test_uniform_proposals_alone_are_chosen_where_a_right_head_is_cheaper_than_the_generator(drawn):
    found = choose_proposals(pools(drawn), COSTS, THRESHOLDS, 0.2)
    assert (found.share, found.threshold) == (1.0, 0.5)
    assert found.cost_s < found.alone_s
    passing = [pool.uniform_scored.passing(0.5)[0] for pool in pools(drawn)]
    assert min(passing) <= found.passing <= max(passing)


def test_a_first_turn_draws_more_the_dearer_a_second_one_is():
    passing = np.linspace(0.3, 0.9, 13)
    cheap, dear = first_turn(passing, 0.0), first_turn(passing, 2000.0)
    assert (cheap, dear) == (0.9, 0.3)
    assert dear < first_turn(passing, 400.0) < cheap


def test_a_dear_head_is_shown_what_the_generator_draws(drawn):
    dear = replace(COSTS, head_s=40e-6)
    found = choose_proposals(pools(drawn), dear, THRESHOLDS, 0.2)
    assert found.share == 0.0
    assert found.cost_s == found.alone_s


def test_a_mixture_is_taken_at_the_lowest_threshold_that_makes_it_as_precise(drawn):
    found = choose_proposals(pools(drawn, uniform_right=0.5), COSTS, THRESHOLDS, 0.2)
    assert (found.share, found.threshold) == (1.0, 0.7)
    fixed = choose_proposals(pools(drawn, uniform_right=0.5), COSTS, THRESHOLDS[:1], 0.2)
    assert (fixed.share, fixed.threshold) == (0.0, 0.5)


def test_a_mixture_of_which_too_little_passes_is_none(drawn):
    assert choose_proposals(pools(drawn), COSTS, THRESHOLDS, 0.99).share == 0.0


def test_what_gives_fewer_samples_than_the_generator_is_none(drawn):
    few = []
    for pool in pools(drawn):
        confidence = np.where(np.arange(SAMPLED) % 10 == 0, pool.uniform_scored.confidence, 0.1)
        few.append(replace(pool, uniform_scored=Scored(confidence, pool.uniform_scored.free)))
    assert evaluate(few, COSTS, 1.0, 0.5).missing.min() > 0.0
    assert choose_proposals(few, COSTS, THRESHOLDS, 0.0).share < 1.0


def test_costs_are_those_of_the_bundle_s_own_graphs_and_of_no_clock(tmp_path, monkeypatch):
    bundle = Bundle.load(write_tiny_bundle(tmp_path / "bundle", validity=True))
    ticks = itertools.count()
    for clock in ("perf_counter", "monotonic", "time", "process_time"):
        # A machine that gets slower from one look to the next.
        monkeypatch.setattr(time, clock, lambda: float(next(ticks)) ** 2)
    first, again = proposal_costs(bundle), proposal_costs(bundle)
    assert first == again
    assert min(first.learned_s, first.uniform_s, first.head_s, first.turn_s) > 0.0


def test_the_shipped_planar_model_is_worth_its_uniform_proposals():
    """Its head costs half of its generator, as clocks had it when it was calibrated."""
    costs = proposal_costs(Bundle.load(PRETRAINED))
    assert costs.learned_s / costs.head_s == pytest.approx(5.095 / 2.653, rel=0.25)
    assert costs.uniform_s < 0.1 * costs.head_s
