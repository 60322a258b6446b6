"""Planning problems of the spatial world: always solvable, and of what their names say."""

import numpy as np
import pytest

from cspace.simulator import Split
from cspace.worlds.spatial import problems
from cspace.worlds.spatial.collision import CollisionChecker
from cspace.worlds.spatial.furniture import FAMILIES, SpatialScenes
from cspace.worlds.spatial.problems import CONE_RAD, KINDS, PathLimits, draw_problem
from tests.cspace.worlds.spatial.test_robots import PANDA, READY, UR5

# Compiling the kernels takes longer than the tests.
pytestmark = pytest.mark.slow

SCENES = SpatialScenes()
QUICK = PathLimits(tries=1)


def reaches_into(arm, configurations, region):
    """Which of (N, d) rad bring the tool into a region, (N,), to a millimetre and 25 degrees."""
    tools = arm.tool_frames(configurations)
    pose, half = np.array(region.box.pose), np.array(region.box.half_m)
    inside = np.abs((tools[:, :3, 3] - pose[:3, 3]) @ pose[:3, :3]) <= half + 1e-3
    return inside.all(axis=1) & (tools[:, :3, 2] @ region.approach >= np.cos(CONE_RAD))


def _reaches(problem, configuration):
    """Whether the tool is in one of the problem's regions."""
    return any(reaches_into(PANDA, configuration[None], region)[0] for region in problem.layout.regions)


def _problem_of(kind, *arguments):
    """A problem of one kind, or of any."""
    with pytest.MonkeyPatch.context() as patch:
        if kind is not None:
            patch.setattr(problems, "SHARES", tuple(float(one == kind) for one in KINDS))
        return draw_problem(*arguments, limits=QUICK)


@pytest.fixture(scope="module")
def drawn():
    """Of every family one of each kind, and one of any."""
    return [
        _problem_of(kind, PANDA, SCENES, Split.VALIDATION, 0, index, family)
        for family in FAMILIES
        for index, kind in enumerate((None, *KINDS))
    ]


def test_every_family_gives_problems_with_a_way_that_solves_them(drawn):
    assert [one.layout.family for one in drawn] == [family for family in FAMILIES for _ in range(4)]
    trivial = []
    for one in drawn:
        checker = CollisionChecker(PANDA, one.layout.obstacles)
        assert checker.valid_batch(np.stack([one.start, one.goal])).all()
        assert np.array_equal(one.path[0], one.start)
        assert np.array_equal(one.path[-1], one.goal)
        assert checker.edge_batch(one.path[:-1], one.path[1:], 0.01).all()
        trivial.append(checker.edge(one.start, one.goal, 0.01))
        first, second = PANDA.tool_frames(np.stack([one.start, one.goal]))[:, :3, 3]
        assert np.linalg.norm(first - second) >= 0.15
        assert not any(values.flags.writeable for values in (one.start, one.goal, one.path))
    assert np.mean(trivial) <= 1 / 3


def test_a_hand_that_reaches_in_is_within_a_region(drawn):
    for one in drawn:
        reached = (_reaches(one, one.start), _reaches(one, one.goal))
        if one.kind == "reach_in":
            assert reached[1]
            assert np.linalg.norm(one.start - READY[0]) < 2.0
        elif one.kind == "between":
            assert all(reached)
        else:
            assert reached[0]
    kinds = [one.kind for one in drawn]
    assert [kind for place, kind in enumerate(kinds) if place % 4] == list(KINDS) * len(FAMILIES)


@pytest.mark.parametrize("family", FAMILIES)
def test_another_arm_has_problems_of_every_family_too(family):
    found = draw_problem(UR5, SCENES, Split.VALIDATION, 0, 0, family, limits=QUICK)
    checker = CollisionChecker(UR5, found.layout.obstacles)
    assert checker.edge_batch(found.path[:-1], found.path[1:], 0.01).all()
    ends = np.stack([found.start, found.goal])
    assert any(reaches_into(UR5, ends, region).any() for region in found.layout.regions)
