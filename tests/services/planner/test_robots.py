"""Who plans for one robot takes no other one's samples."""

import pytest

from cspace.errors import SamplerError
from cspace.query import SampleQuery
from cspace.simulator import Split
from cspace.worlds import default_world, examples, robot_digest
from cspace.worlds.planar.problems import Family, draw_problem
from services.planner.planning import SampleRequest, plan
from services.planner.result import PlannerSettings
from services.planner.samples import LocalSampler
from tests.bundles import picture, write_tiny_bundle
from tests.fakes.sample_source import FakeSampleSource

TWO, THREE, *_ = (robot_digest(world) for world in examples().values())


def test_a_bundle_of_another_robot_does_not_answer(tmp_path):
    folder = write_tiny_bundle(tmp_path / "bundle")
    assert LocalSampler(folder, robot=TWO).sample(picture(), 3).robot == TWO
    for source, query in (
        (LocalSampler(folder, robot=THREE), SampleQuery(3, 1)),
        (LocalSampler(folder), SampleQuery(3, 1, robot=THREE)),
    ):
        with pytest.raises(SamplerError, match="another robot"):
            source.answer(b"not even a picture", query)


def test_a_planner_names_the_robot_of_its_problem():
    source, problem = FakeSampleSource(), draw_problem(Family.UNIFORM, Split.DEMO, 1)
    plan(problem, source, PlannerSettings(seed=3), SampleRequest(SampleQuery(40, 3)))
    assert source.requests[0].query.robot == robot_digest(default_world())
