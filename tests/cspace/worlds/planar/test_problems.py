from functools import cache

import numpy as np
import pytest
from scipy import ndimage

from cspace.errors import ScenarioError
from cspace.simulator import Split
from cspace.worlds import simulator_of
from cspace.worlds.planar.arm import THREE_LINK
from cspace.worlds.planar.collision import CollisionChecker
from cspace.worlds.planar.problems import FINE_CELLS, NARROW_RAD, Family, FreeGrid, draw_problem
from cspace.worlds.planar.world import PlanarWorld

CELLS = 512
STEP_RAD = 2 * np.pi / CELLS
# With this seed that narrow problem is found after few draws.
NARROW = 12


class Independent:
    """The two-link torus once more, on nine tiles and with nothing of the package but the kernel."""

    def __init__(self, scenario):
        axis = -np.pi + (np.arange(CELLS) + 0.5) * STEP_RAD
        centres = np.stack(np.meshgrid(axis, axis, indexing="ij"), axis=-1).reshape(-1, 2)
        self.free = CollisionChecker(scenario).valid_batch(centres).reshape(CELLS, CELLS)
        tiles = ndimage.distance_transform_edt(np.tile(self.free, (3, 3)), sampling=STEP_RAD)
        self.clearance = tiles[CELLS : 2 * CELLS, CELLS : 2 * CELLS]

    def cell(self, q):
        return tuple(np.floor((np.asarray(q) + np.pi) / STEP_RAD).astype(int))

    def joined(self, a, b, mask, structure=None):
        """Grow from the first cell, one pass of the plane and one of the seams at a time."""
        labels, _ = ndimage.label(mask, structure)
        reached = {labels[self.cell(a)]} - {0}
        while True:
            inside = np.isin(labels, list(reached))
            found = set()
            for axis in (0, 1):
                for here, there in ((0, -1), (-1, 0)):
                    edge, other = np.take(inside, here, axis), np.take(labels, there, axis)
                    found |= set(other[edge]) - {0}
                    if structure is not None:
                        for shift in (-1, 1):
                            found |= set(np.roll(other, shift)[edge]) - {0}
            if found <= reached:
                return bool(labels[self.cell(b)] in reached)
            reached |= found


def fine_grid(scenario):
    return FreeGrid(scenario, FINE_CELLS)


@cache
def independent(scenario):
    return Independent(scenario)


@pytest.fixture(scope="module")
def uniform():
    return draw_problem(Family.UNIFORM, Split.TEST, 7, 0)


@pytest.fixture(scope="module")
def narrow():
    return draw_problem(Family.NARROW, Split.TEST, 7, NARROW)


@pytest.fixture(scope="module")
def disconnected():
    return draw_problem(Family.DISCONNECTED, Split.TEST, 7, 3)


def test_the_ends_of_a_uniform_problem_share_a_component(uniform):
    check = independent(uniform.scenario)
    assert check.joined(uniform.start, uniform.goal, check.free)
    assert check.joined(uniform.start, uniform.goal, check.clearance >= uniform.bottleneck_rad - 1e-6)
    assert not check.joined(uniform.start, uniform.goal, check.clearance > uniform.bottleneck_rad + 1e-6)


def test_a_narrow_problem_has_its_bottleneck_in_the_band(narrow):
    low, high = NARROW_RAD
    assert low <= narrow.bottleneck_rad <= high
    check = independent(narrow.scenario)
    assert check.joined(narrow.start, narrow.goal, check.clearance > low)
    assert not check.joined(narrow.start, narrow.goal, check.clearance > high)
    assert fine_grid(narrow.scenario).bottleneck_rad(narrow.start, narrow.goal) == narrow.bottleneck_rad
    assert narrow.rejected > 0
    # It is the passage that is narrow and not the ends.
    for end in (narrow.start, narrow.goal):
        assert check.clearance[check.cell(end)] > NARROW_RAD[1]


def test_the_ends_of_a_disconnected_problem_are_in_different_components(disconnected):
    check = independent(disconnected.scenario)
    everywhere = np.ones((3, 3))
    assert disconnected.bottleneck_rad == 0.0
    assert disconnected.rejected > 0
    assert check.free[check.cell(disconnected.start)]
    assert check.free[check.cell(disconnected.goal)]
    assert not check.joined(disconnected.start, disconnected.goal, check.free, everywhere)
    assert not fine_grid(disconnected.scenario).joined(disconnected.start, disconnected.goal)


def test_a_problem_is_fixed_by_family_split_seed_and_index():
    problems = [
        draw_problem(Family.UNIFORM, split, seed, index)
        for split, seed, index in [
            (Split.TEST, 7, 0),
            (Split.TEST, 7, 0),
            (Split.TEST, 7, 1),
            (Split.TEST, 8, 0),
            (Split.VALIDATION, 7, 0),
        ]
    ]
    starts = [tuple(problem.start) for problem in problems]
    assert starts[0] == starts[1]
    assert len(set(starts)) == 4
    assert (problems[0].scenario, problems[0].rejected, problems[0].seed) == (
        problems[1].scenario, problems[1].rejected, 7,
    )  # fmt: skip


def test_three_links_have_uniform_and_no_narrow_problems():
    problem = draw_problem(Family.UNIFORM, Split.TEST, 7, 0, THREE_LINK)
    assert problem.start.shape == problem.goal.shape == (3,)
    assert CollisionChecker(problem.scenario).valid_batch([problem.start, problem.goal]).all()
    with pytest.raises(ScenarioError, match="no such family"):
        simulator_of(PlanarWorld(THREE_LINK)).problem(Family.NARROW, Split.TEST, 7)
