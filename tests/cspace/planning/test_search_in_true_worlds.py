"""The search alone: where the worlds that it is fed with are the truth, its plans rarely collide."""

import time

import numpy as np
import pytest

from cspace.planning.paths import spaced
from cspace.planning.search import SearchLimits, find_paths
from cspace.simulator import Split
from cspace.worlds import examples
from cspace.worlds.spatial.benchmark import problems, with_benchmark_limits
from cspace.worlds.spatial.bodies import distance_m
from cspace.worlds.spatial.collision import CollisionChecker, world_checkers
from cspace.worlds.spatial.furniture import FAMILIES, SpatialScenes
from cspace.worlds.spatial.problems import PathLimits, draw_problem

PANDA = examples()["panda"]
# Kept to obstacles where there is room; every world is searched with all states before the next.
MARGINS_M = (0.01, 0.005, 0.0)
FULL = SearchLimits(first=4096, search_rad=0.03, shortcut_rad=0.01)
EACH = 6


def own_problems():
    """Obstacles, start and goal in scenes of each family."""
    for family in FAMILIES:
        for index in range(EACH):
            one = draw_problem(
                PANDA.body, SpatialScenes(), Split.VALIDATION, 0, index, family, limits=PathLimits(tries=1)
            )
            yield PANDA, one.layout.obstacles, one.start, one.goal


def benchmark_problems():
    """The same of MotionBenchMaker's validation problems."""
    world = with_benchmark_limits(PANDA)
    for one in problems(Split.VALIDATION):
        yield world, one.obstacles, np.array(one.start), np.array(one.goal)


@pytest.mark.slow
@pytest.mark.timeout(600)
@pytest.mark.parametrize("drawn", [own_problems, benchmark_problems])
def test_plans_in_true_worlds_collide_in_at_most_three_of_a_hundred_problems(drawn):
    asked, clearances = 0, []
    for world, obstacles, start, goal in drawn():
        truth, ends, grid = (
            CollisionChecker(world.body, obstacles),
            np.stack([start, goal]),
            world.sensor.grid,
        )
        if not truth.valid_batch(ends).all():
            continue
        asked += 1
        away = np.minimum(distance_m(obstacles, grid.centres_m()), 0.5).astype(np.float32)
        worlds = [away - np.float32(margin_m) for margin_m in MARGINS_M]
        checkers = world_checkers(world.body, worlds, grid, ends)
        found = find_paths(checkers, start, goal, 1, 0, time.thread_time() + 60.0, limits=FULL)
        clearances += [truth.clearance(spaced(path, world.space, 0.01)).min() for path in found.paths]
    assert len(clearances) >= 0.94 * asked
    assert np.mean(np.array(clearances) <= 0.0) <= 0.03
