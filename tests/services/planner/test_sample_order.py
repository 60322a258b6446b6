"""Samples ordered along the way through them, and by whether they collide."""

import numpy as np
import pytest

from cspace.worlds.planar.arm import TWO_LINK, PlanarArm
from cspace.worlds.planar.checks import CollisionChecker
from services.planner.rrt_connect import colliding_last, order_along

SPACE = TWO_LINK.space


def test_samples_of_a_straight_way_come_from_start_to_goal_in_sweeps():
    samples = np.stack([np.linspace(0.1, 0.9, 9), np.zeros(9)], axis=1)
    shuffled = np.random.default_rng(0).permutation(9)
    order = order_along(samples[shuffled], (0.0, 0.0), (1.0, 0.0), SPACE, sweep=3)
    assert shuffled[order].tolist() == [0, 3, 6, 1, 4, 7, 2, 5, 8]


def test_a_way_that_bends_back_is_followed_not_cut_across():
    # A horseshoe: start and goal are near each other, the samples go round.
    angle = np.linspace(0.3, 2.0 * np.pi - 0.3, 60)
    samples = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    shuffled = np.random.default_rng(1).permutation(60)
    order = order_along(samples[shuffled], (1.0, 0.1), (1.0, -0.1), SPACE, sweep=60)
    # The short way between start and goal is one hop of 0.2 rad, as short as the hops of the horseshoe.
    wide = order_along(samples[shuffled], samples[0], samples[-1], SPACE, sweep=60)
    assert np.array_equal(np.sort(order), np.arange(60))
    assert np.abs(np.diff(shuffled[wide])).max() <= 3


def test_a_way_round_the_seam_is_one_way_and_with_limits_it_is_not():
    samples = SPACE.wrap(np.stack([np.linspace(2.8, 3.5, 8), np.zeros(8)], axis=1))
    shuffled = np.random.default_rng(2).permutation(8)
    ends = (2.7, 0.0), (3.6 - 2 * np.pi, 0.0)
    assert shuffled[order_along(samples[shuffled], *ends, SPACE, sweep=8)].tolist() == list(range(8))
    limited = PlanarArm(joint_limits_rad=((-3.14159, 3.14159), None)).space
    kept = samples[(samples[:, 0] > -3.14159) & (samples[:, 0] < 3.14159)]
    assert len(order_along(kept, *ends, limited)) == len(kept)


@pytest.mark.parametrize("count", [0, 1, 2, 25])
def test_every_sample_is_kept_once_even_where_all_are_alike(count):
    order = order_along(np.zeros((count, 2)), (0.0, 0.0), (0.0, 0.0), SPACE)
    assert sorted(order.tolist()) == list(range(count))


def test_those_that_collide_come_last_and_else_the_order_stays(blocked):
    checker = CollisionChecker(blocked.scenario)
    samples = np.random.default_rng(0).uniform(-9.0, 9.0, (200, 2))
    free = checker.valid_batch(SPACE.wrap(samples))
    assert 20 < free.sum() < 180
    order = colliding_last(samples, checker)
    assert order.tolist() == [*np.flatnonzero(free), *np.flatnonzero(~free)]


def test_of_no_samples_the_order_is_empty(blocked):
    assert len(colliding_last(np.empty((0, 2)), CollisionChecker(blocked.scenario))) == 0
