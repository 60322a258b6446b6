"""Refined paths: round places of low confidence, through what the picture leaves free."""

import numpy as np
import pytest

from cspace.planning.cost import score
from cspace.planning.refine import Effort, PathRefiner, cheapest_route
from cspace.planning.search import OutOfTimeError
from cspace.worlds import examples

SPACE = examples()["two-link"].space
PATH = np.array([[-1.5, 0.0], [1.5, 0.0]])
PLAIN = (0.0, 1.0)


class Open:
    """All is free, but what a test shuts."""

    space = SPACE

    def __init__(self, shut=lambda rows: np.zeros(len(rows), dtype=bool)):
        self.shut = shut

    def valid_batch(self, rows):
        return ~self.shut(np.asarray(rows))

    def edge_batch(self, starts, ends, resolution):
        shares = np.linspace(0.0, 1.0, 60)[:, None, None]
        rows = starts + shares * SPACE.difference(starts, ends)
        return ~np.array([self.shut(row).any() for row in np.moveaxis(rows, 1, 0)])


def hill(rows):
    """Low confidence in the middle of the straight path, high half a rad away from it."""
    away = np.linalg.norm(rows / [1.0, 0.5], axis=1)
    return (1.0 - 0.9 * np.exp(-((away / 0.5) ** 2))).astype(np.float32), None


def scored(path, predict=hill):
    return score([path], SPACE, 0.1, predict)[0]


def refiner(checker=None, predict=hill, check_cancelled=lambda: None, **effort):
    limits = Effort(step_rad=0.1, **effort)
    return PathRefiner(checker or Open(), predict, PLAIN, limits, check_cancelled)


def test_a_path_is_led_round_places_of_low_confidence():
    before = scored(PATH)
    after = refiner().refine(before, np.random.default_rng(0))
    assert np.array_equal(after.path[[0, -1]], PATH)
    assert after.cost < 0.3 * before.cost
    assert after.length_rad < 1.6 * before.length_rad
    again = refiner().refine(before, np.random.default_rng(0))
    assert np.array_equal(again.path, after.path)


def test_what_the_picture_shows_is_kept_to():
    # The model would like to pass above, where the picture has a wall.
    wall = Open(lambda rows: (np.abs(rows[:, 0]) < 0.2) & (rows[:, 1] > 0.15))
    after = refiner(wall).refine(scored(PATH), np.random.default_rng(1))
    assert wall.edge_batch(after.path[:-1], after.path[1:], 0.01).all()
    assert after.states[np.abs(after.states[:, 0]) < 0.2, 1].max() <= 0.15
    assert after.cost < scored(PATH).cost


@pytest.mark.parametrize("seed", range(2))
def test_a_path_never_costs_more_than_before(seed):
    def noisy(rows):
        return (0.6 + 0.4 * np.sin(37.0 * rows.sum(axis=1)) ** 2).astype(np.float32), None

    before = scored(PATH, noisy)
    after = refiner(predict=noisy).refine(before, np.random.default_rng(seed))
    assert after.cost <= before.cost


def test_a_ridge_between_two_states_is_seen_before_a_path_crosses_it():
    def ridge(rows):
        return np.where(np.abs(rows[:, 0]) < 0.05, 0.05, 1.0).astype(np.float32), None

    # Neighbours 0.3 rad apart at either side of it look safe.
    before = score([PATH], SPACE, 0.3, ridge)[0]
    shut = Open(lambda rows: np.abs(rows[:, 1]) > 0.6)
    one = PathRefiner(shut, ridge, PLAIN, Effort(step_rad=0.05), lambda: None)
    after = one.refine(scored(before.path, ridge), np.random.default_rng(0))
    assert after.confidence.min() == np.float32(0.05)


def test_a_confident_path_is_left_alone_without_a_prediction():
    def never(rows):
        raise AssertionError

    sure = scored(PATH, lambda rows: (np.ones(len(rows), np.float32), None))
    assert refiner(predict=never).refine(sure, np.random.default_rng(0)) is sure


def test_the_time_ends_it_with_the_best_so_far():
    turns = iter(range(100))

    def late():
        if next(turns) == 2:
            raise OutOfTimeError

    before = scored(PATH)
    after = refiner(check_cancelled=late, enough=0.0).refine(before, np.random.default_rng(0))
    assert next(turns) == 3
    assert after.cost < before.cost


def test_the_cheapest_route_is_that_of_all_routes():
    rng = np.random.default_rng(3)
    for _ in range(20):
        costs = np.where(rng.random((6, 6)) < 0.5, rng.random((6, 6)), np.inf)
        best = costs.copy()
        np.fill_diagonal(best, 0.0)
        for middle in range(6):
            best = np.minimum(best, best[:, middle, None] + best[None, middle])
        route = cheapest_route(costs, 0, 5)
        if route is None:
            assert np.isinf(best[0, 5])
        else:
            assert costs[route[:-1], route[1:]].sum() == pytest.approx(best[0, 5])
