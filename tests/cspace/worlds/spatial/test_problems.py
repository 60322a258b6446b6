"""Planning problems of the spatial world: always solvable, and of what their names say."""

import numpy as np
import pytest

from cspace.errors import ScenarioError
from cspace.simulator import Split
from cspace.worlds.spatial import problems
from cspace.worlds.spatial.checks import CollisionChecker
from cspace.worlds.spatial.furniture import FAMILIES, SpatialScenes
from cspace.worlds.spatial.problems import KINDS, PathLimits, draw_problem, reaches_into
from cspace.worlds.spatial.scenes import draw_layout
from tests.cspace.worlds.spatial.test_robots import PANDA, READY, UR5
from tests.cspace.worlds.spatial.test_ways import TWO_LINKS

# Compiling the kernels takes longer than the tests.
pytestmark = pytest.mark.slow

SCENES = SpatialScenes()
QUICK = PathLimits(tries=1)


def _reaches(problem, configuration):
    """Whether the tool is in one of the problem's regions."""
    return any(reaches_into(PANDA, configuration[None], region)[0] for region in problem.layout.regions)


@pytest.fixture(scope="module")
def drawn():
    """Of every family one of each kind, and one of any."""
    return [
        draw_problem(PANDA, SCENES, Split.VALIDATION, 0, index, family, kind=kind, limits=QUICK)
        for family in FAMILIES
        for index, kind in enumerate((None, *KINDS))
    ]


def test_every_family_gives_problems_with_a_way_that_solves_them(drawn):
    assert [one.layout.family for one in drawn] == [family for family in FAMILIES for _ in range(4)]
    for one in drawn:
        checker = CollisionChecker(PANDA, one.layout.obstacles)
        assert checker.valid_batch(np.stack([one.start, one.goal])).all()
        assert np.array_equal(one.path[0], one.start)
        assert np.array_equal(one.path[-1], one.goal)
        assert checker.edge_batch(one.path[:-1], one.path[1:], 0.01).all()
        assert one.is_trivial == checker.edge(one.start, one.goal, 0.01)
        first, second = PANDA.tool_frames(np.stack([one.start, one.goal]))[:, :3, 3]
        assert np.linalg.norm(first - second) >= 0.15
        assert not any(values.flags.writeable for values in (one.start, one.goal, one.path))
    assert np.mean([one.is_trivial for one in drawn]) <= 1 / 3


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


def test_split_seed_and_index_alone_tell_a_problem():
    keys = [(Split.VALIDATION, 0, 0), (Split.TRAIN, 0, 0), (Split.VALIDATION, 1, 0), (Split.VALIDATION, 0, 1)]
    first = [draw_problem(PANDA, SCENES, *one, limits=QUICK) for one in keys]
    again = [draw_problem(PANDA, SCENES, *one, limits=QUICK) for one in reversed(keys)][::-1]
    for one, other in zip(first, again, strict=True):
        assert one.layout == other.layout
        assert (one.kind, one.rejected, one.is_trivial) == (other.kind, other.rejected, other.is_trivial)
        assert np.array_equal(one.path, other.path)
    assert len({str(one.layout.to_dict()) for one in first}) == len(keys)
    assert len({one.start.tobytes() for one in first}) == len(keys)


@pytest.mark.parametrize("family", FAMILIES)
def test_another_arm_has_problems_of_every_family_too(family):
    found = draw_problem(UR5, SCENES, Split.VALIDATION, 0, 0, family, limits=QUICK)
    checker = CollisionChecker(UR5, found.layout.obstacles)
    assert checker.edge_batch(found.path[:-1], found.path[1:], 0.01).all()
    ends = np.stack([found.start, found.goal])
    assert any(reaches_into(UR5, ends, region).any() for region in found.layout.regions)


def test_a_problem_of_a_named_kind_has_the_scene_of_its_index_where_that_has_one():
    for kind in KINDS:
        found = draw_problem(PANDA, SCENES, Split.TEST, 3, 0, "table", kind=kind, limits=QUICK)
        assert found.kind == kind
        assert found.layout == draw_layout(SCENES, Split.TEST, 3, 0, "table")


def test_where_there_is_no_problem_an_error_says_so(monkeypatch):
    monkeypatch.setattr(problems, "MAX_DRAWS", 2)
    with pytest.raises(ScenarioError, match="no problem of the kind between was found; expected one in 2"):
        # Its tool points along z for ever, and shelves are reached into along x.
        draw_problem(TWO_LINKS, SCENES, Split.TRAIN, 0, 0, "shelf", kind="between", limits=QUICK)
    with pytest.raises(ScenarioError, match="kind of problem is unknown"):
        draw_problem(PANDA, SCENES, Split.TRAIN, 0, 0, kind="fly")
    with pytest.raises(ScenarioError, match="family of scenes is unknown"):
        draw_problem(PANDA, SCENES, Split.TRAIN, 0, 0, "garden")
