"""A checker of one's own, samples of any source, and OMPL's RRT."""

import re

import numpy as np
import pytest
from ompl import util as ou

from cspace.worlds import picture_file_of
from cspace.worlds.planar.arm import TWO_LINK
from cspace.worlds.planar.collision import CollisionChecker
from cspace.worlds.planar.world import Disc, Scenario
from cspace_client import JointSpace, PlanningError, SampleBatch
from cspace_client.ompl import LearnedSampler, Problem, learned_sampler
from inference_api.settings import PRETRAINED_FOLDER
from services.planner.samples import LocalSampler
from tests.docs.blocks import ROOT
from tests.docs.tiny_api import DOCUMENTED
from tests.fakes.sample_source import DIGEST, MODEL

BLOCK = re.compile(r"```python\n(.*?)```", re.DOTALL)
START, GOAL = (-1.0, -1.0), (1.0, 1.0)
BOX = JointSpace((-4.0, -2.0), (4.0, 2.0), (False, False))


@pytest.fixture(autouse=True)
def quiet():
    ou.setLogLevel(ou.LOG_NONE)


class Source:
    """Uniform samples of a joint space, and what it was asked."""

    def __init__(self, space=None):
        self.space, self.requests = space, []

    def answer(self, picture, query, model=None):
        self.requests.append((picture, query, model))
        joints = self.space or JointSpace((-np.pi,) * 2, (3.0,) * 2, (True,) * 2)
        samples = joints.sample_uniform(np.random.default_rng(query.seed), query.n).astype(np.float32)
        return SampleBatch(samples, MODEL, 0, DIGEST, query.seed, 0, 0.0, space=self.space)


def wall(joints, slack_rad=0.0):
    """The first joint passes zero only where the second is near one and a half."""
    return abs(joints[0]) > 0.3 - slack_rad or abs(joints[1] - 1.5) < 0.3 + slack_rad


def planner_of(is_free=wall, space=None, start=START, goal=GOAL, **options):
    return learned_sampler(Problem(b"", start, goal, is_free), Source(space), seed=1, **options)


@pytest.mark.parametrize("space", [None, BOX], ids=["circles", "limits"])
def test_every_state_of_the_path_has_passed_the_checker_and_it_leads_from_start_to_goal(space):
    seen = []

    def looked_at(joints):
        seen.append(joints)
        return wall(joints)

    found = planner_of(looked_at, space).solve(10.0)
    np.testing.assert_allclose(found.path[[0, -1]], [START, GOAL])
    assert all(wall(row) for row in found.path)
    assert found.learned_drawn > 0
    # Both ends were looked at before.
    assert len(seen) == found.state_checks + 2
    # Between its corners by no more than the resolution; circles may be passed the other way round.
    pieces = zip(found.path, found.path[1:], strict=False)
    along = np.concatenate([np.linspace(*ends, 50) for ends in pieces])
    assert space is None or all(wall(row, 0.03) for row in along)


def test_it_may_be_solved_again_and_the_same_seed_draws_the_same():
    planner = planner_of()
    first, again, uniform = (planner.solve(seed=3, uniform_share=share) for share in (0.3, 0.3, 1.0))
    counts = [(one.learned_drawn, one.uniform_drawn, one.goal_drawn) for one in (first, again)]
    assert counts[0] == counts[1]
    assert uniform.learned_drawn == 0 < uniform.uniform_drawn


def test_what_the_checker_raises_comes_out_and_ends_the_search():
    left = iter(range(50))

    def failing(joints):
        if next(left, None) is None:
            raise KeyError("of the checker")
        return wall(joints)

    planner = planner_of(failing)
    with pytest.raises(KeyError, match="of the checker") as raised:
        planner.solve(60.0)
    # What outlives OMPL's state would be taken for a later state at the same address, whatever its kind.
    assert not [name for step in raised.traceback for name in step.frame.f_locals if name == "state"]


@pytest.mark.parametrize(
    ("ends", "words"),
    [
        ({"start": (0.0, 0.0)}, "start is not free"),
        ({"goal": (0.0, 0.0, 0.0)}, "goal is no configuration of this robot"),
        ({"goal": (5.0, 0.0), "space": BOX}, "within their limits"),
        ({"start": (np.nan, 0.0), "space": BOX}, "start is no configuration"),
    ],
)
def test_ends_that_can_not_be_are_told_before_the_search(ends, words):
    with pytest.raises(PlanningError, match=words):
        planner_of(**ends)


def test_samples_at_limits_in_single_precision_are_within_them():
    limit = 2.8973
    space = JointSpace((-limit, -limit), (limit, limit), (False, False))
    samples = np.full((20, 2), limit, np.float32)
    assert samples.astype(np.float64).max() > limit
    batch = SampleBatch(samples, MODEL, 0, DIGEST, 1, 0, 0.0, space=space)
    found = LearnedSampler(Problem(b"", START, GOAL, lambda joints: True), batch).solve(uniform_share=0.0)
    assert found.path is not None


def test_start_and_goal_are_sent_where_they_are_wanted():
    source = Source()
    problem = Problem(b"picture", np.array(START), GOAL, wall)
    learned_sampler(problem, source, n=7, model="path-sampler", with_ends=True)
    learned_sampler(problem, source)
    (with_ends, without) = source.requests
    assert (with_ends[0], with_ends[2], with_ends[1].n) == (b"picture", "path-sampler", 7)
    assert (with_ends[1].start, with_ends[1].goal) == (list(START), list(GOAL))
    assert (without[1].start, without[1].goal, without[1].n) == (None, None, 300)


@pytest.fixture
def documented(monkeypatch):
    """The names of the scene in docs/client.md."""
    monkeypatch.chdir(ROOT)
    names = {}
    exec(BLOCK.findall((ROOT / "docs/client.md").read_text(encoding="utf-8"))[0], names)  # noqa: S102 - our own
    return names


def test_a_plan_with_samples_of_the_shipped_bundle_is_free_in_the_scene_that_the_documents_picture_shows(
    documented,
):
    scene = Scenario(TWO_LINK, tuple(Disc(*disc) for disc in documented["DISCS"]))
    assert picture_file_of(scene) == documented["picture"]
    problem = Problem(*(documented[name] for name in ("picture", "START", "GOAL", "is_free")))
    batch = LocalSampler(PRETRAINED_FOLDER).sample(problem.picture, 300, seed=7)
    found = LearnedSampler(problem, batch).solve(10.0)
    assert CollisionChecker(scene).valid_batch(found.path).all()
    assert found.learned_drawn > 0


def test_the_packages_own_readme_runs(tiny_api, documented):
    (block,) = BLOCK.findall((ROOT / "clients/python/README.md").read_text(encoding="utf-8"))
    names = documented | {"start": documented["START"], "goal": documented["GOAL"]}
    exec(block.replace(DOCUMENTED, tiny_api.address("README.md")), names)  # noqa: S102 - the project's own
    assert DOCUMENTED in block
    np.testing.assert_allclose(names["path"][[0, -1]], [documented["START"], documented["GOAL"]])
