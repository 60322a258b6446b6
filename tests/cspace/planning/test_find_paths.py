"""Ways through what pictures show, in both worlds, by the compiled checks of each."""

import time

import numpy as np
import pytest

from cspace.planning.paths import length_rad, shortcut
from cspace.planning.search import SearchLimits, find_paths
from cspace.simulator import Split
from cspace.worlds import examples, seen_checkers, simulator_of
from cspace.worlds.planar.simulator import render
from cspace.worlds.planar.world import Disc, Scenario
from cspace.worlds.spatial.arm import ready_rad
from cspace.worlds.spatial.bodies import distance_m
from cspace.worlds.spatial.collision import CollisionChecker
from cspace.worlds.spatial.furniture import block
from cspace.worlds.spatial.obstacles import Obstacles

PLANAR, PANDA = (examples()[name] for name in ("two-link", "panda"))
LATE = 1e9


def planar(index):
    """The true checker, the picture and the ends of a problem."""
    simulator = simulator_of(PLANAR)
    problem = simulator.problem("uniform", Split.VALIDATION, 0, index)
    picture, ends = simulator.render(problem.scenario), np.stack([problem.start, problem.goal])
    return simulator.checker(problem.scenario), picture, ends


@pytest.mark.parametrize("index", range(3))
def test_ways_through_a_picture_are_nearly_free_in_the_scene(index):
    truth, picture, ends = planar(index)
    checkers = seen_checkers(PLANAR, picture, ends)
    found = find_paths(checkers, *ends, 4, 0, time.thread_time() + LATE)
    assert (len(found.paths), found.late) == (4, False)
    assert found.checker in checkers
    for path in found.paths:
        assert np.array_equal(path[[0, -1]], ends)
        # Pixels are 0.2 m wide.
        assert truth.clearance(path).min() > -0.1
    again = find_paths(checkers, *ends, 4, 0, time.thread_time() + LATE)
    assert all(np.array_equal(one, other) for one, other in zip(found.paths, again.paths, strict=True))
    assert len({path.tobytes() for path in found.paths}) > 1


def test_the_more_careful_checks_know_more_obstacles():
    truth, picture, ends = planar(0)
    checkers = seen_checkers(PLANAR, picture, ends)
    rows = PLANAR.space.sample_uniform(np.random.default_rng(0), 3000)
    shares = [checker.valid_batch(rows).mean() for checker in checkers]
    assert shares == sorted(shares)
    assert shares[0] < shares[-1]
    # The middle one is as right as its pixels are fine.
    assert (checkers[1].valid_batch(rows) == truth.valid_batch(rows)).mean() > 0.93


def test_ends_are_free_whatever_seems_to_stand_there():
    scene = Scenario(PLANAR.body, (Disc(2.0, 0.0),), PLANAR.sensor)
    ends = np.array([[0.0, 0.0], [2.0, 0.5]])
    assert not simulator_of(PLANAR).checker(scene).valid(ends[0])
    for checker in seen_checkers(PLANAR, render(scene), ends):
        assert checker.valid_batch(ends).all()


def test_the_time_ends_a_search():
    _, picture, ends = planar(1)
    found = find_paths(seen_checkers(PLANAR, picture, ends), *ends, 1000, 0, time.thread_time() + 0.05)
    assert found.late
    assert len(found.paths) < 1000


def test_what_a_search_waits_for_others_is_not_its_own_time():
    limit_s = 0.4

    def wait():
        if time.monotonic() - began < limit_s:
            time.sleep(limit_s)

    _, picture, ends = planar(1)
    checkers = seen_checkers(PLANAR, picture, ends)
    find_paths(checkers, *ends, 1, 0, time.thread_time() + LATE)
    began = time.monotonic()
    found = find_paths(checkers, *ends, 10, 0, time.thread_time() + limit_s, check_cancelled=wait)
    assert time.monotonic() - began > limit_s
    assert (len(found.paths), found.late) == (10, False)


class Wall:
    """Nothing but the ends is free; counts the states that trees were to grow towards."""

    space = PLANAR.space

    def __init__(self):
        self.states = 0

    def valid_batch(self, rows):
        return np.ones(len(rows), dtype=bool)

    def grow_trees(self, nodes, parents, counts, checks, states, side, *lengths):
        self.states += len(states)
        return len(states), side, -1, -1


def test_no_way_is_found_where_there_is_none():
    wall = Wall()
    found = find_paths([wall], np.zeros(2), np.ones(2), 3, 0, time.thread_time() + LATE)
    assert (found.paths, found.late, found.checker) == ([], False, None)
    assert wall.states == sum(SearchLimits().rounds()) == 256 + 1024 + 4096


def test_a_careful_checker_without_a_way_takes_few_states_before_the_next_is_tried():
    wall, (truth, _, ends) = Wall(), planar(2)
    found = find_paths([wall, truth], *ends, 3, 0, time.thread_time() + LATE)
    assert (len(found.paths), found.late, wall.states) == (3, False, 256)
    assert found.checker is truth
    alone = find_paths(
        [Wall(), truth], *ends, 3, 0, time.thread_time() + LATE, limits=SearchLimits(first=4096)
    )
    for path, other in zip(found.paths, alone.paths, strict=True):
        np.testing.assert_array_equal(path, other)


def test_cutting_short_keeps_ends_and_never_lengthens():
    truth, _, ends = planar(2)
    rng = np.random.default_rng(0)
    path = np.stack([ends[0], [0.1, 0.2], [-2.0, 1.0], [1.5, -1.0], ends[1]])

    class Open:
        space = PLANAR.space

        def edge_batch(self, starts, ends, resolution):
            return np.ones(len(starts), dtype=bool)

    short = shortcut(Open(), path, rng, 64, 0.05)
    assert np.array_equal(short[[0, -1]], path[[0, -1]])
    assert length_rad(short, truth.space) < length_rad(path, truth.space)

    class Shut(Open):
        def edge_batch(self, starts, ends, resolution):
            return np.zeros(len(starts), dtype=bool)

    assert np.array_equal(shortcut(Shut(), path, rng, 64, 0.05), path)


def test_what_depth_pictures_show_is_known_to_a_voxel():
    """A box in front of the arm: poses that are in it are found out, those far from it are free."""
    obstacles = Obstacles.of([block((0.35, 0.6), (-0.3, 0.3), (0.2, 0.9))])
    grid = PANDA.sensor.grid
    away = distance_m(obstacles, grid.centres_m().reshape(-1, 3)).reshape(grid.counts)
    picture = np.zeros((*grid.counts, 2), np.uint8)
    picture[..., 0] = np.clip(away / 0.0004, 0, 255)
    start = ready_rad(PANDA.body)
    ends = np.stack([start * [0, 1, 1, 1, 1, 1, 1] + [2.5, 0, 0, 0, 0, 0, 0], start * 1.0])
    truth = CollisionChecker(PANDA.body, obstacles)
    checkers = seen_checkers(PANDA, picture, ends[:1])
    rows = PANDA.space.sample_uniform(np.random.default_rng(0), 2000)
    rows = rows[np.abs(truth.clearance(rows)) > 0.03]
    found = checkers[-1].valid_batch(rows)
    # Within a surface distances are 0, which spheres of the arm cannot be from their centre.
    assert (found == truth.valid_batch(rows)).mean() > 0.99
    assert checkers[0].valid_batch(rows).sum() <= found.sum()
    assert checkers[0].valid(ends[0])
