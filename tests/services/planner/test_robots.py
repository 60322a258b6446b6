"""Who plans for one robot takes no other one's samples."""

import httpx
import pytest

from cspace.bundle import samples as judging
from cspace.errors import SamplerError
from cspace.query import SampleQuery
from cspace.simulator import Split
from cspace.worlds import default_world, examples, robot_digest
from cspace.worlds.planar.problems import Family, draw_problem
from services.planner.client import SamplingClient
from services.planner.planning import SampleRequest, plan
from services.planner.samples import LocalSampler
from services.planner.settings import PlannerSettings
from tests.bundles import picture, write_tiny_bundle
from tests.fakes.sample_server import read_form, sample_answer
from tests.fakes.sample_source import FakeSampleSource

PNG = b"\x89PNG picture"
TWO, THREE, *_ = (robot_digest(world) for world in examples().values())


def test_the_clients_robot_goes_with_every_request_and_a_requests_own_before_it():
    sent = []

    def handle(request: httpx.Request) -> httpx.Response:
        sent.append(read_form(request.headers["content-type"], request.read()).get("robot"))
        return httpx.Response(200, content=sample_answer([[0.0, 0.0]], robot=TWO))

    for robot in (None, THREE):
        with SamplingClient("http://t", transport=httpx.MockTransport(handle), robot=robot) as client:
            assert client.sample(PNG, 1).robot == TWO
            client.sample(PNG, 1, robot=TWO)
    assert sent == [None, [TWO.encode()], [THREE.encode()], [TWO.encode()]]


def test_a_bundle_of_another_robot_does_not_answer(tmp_path):
    folder = write_tiny_bundle(tmp_path / "bundle")
    assert LocalSampler(folder, robot=TWO).sample(picture(), 3).robot == TWO
    for source, query in (
        (LocalSampler(folder, robot=THREE), SampleQuery(3, 1)),
        (LocalSampler(folder), SampleQuery(3, 1, robot=THREE)),
    ):
        with pytest.raises(SamplerError, match="another robot"):
            source.answer(b"not even a picture", query)


def test_a_bundle_looks_at_a_requests_robot_once(tmp_path, monkeypatch):
    local, looked = LocalSampler(write_tiny_bundle(tmp_path / "bundle"), robot=TWO), []
    monkeypatch.setattr(judging, "robot_digest", lambda world: looked.append(world) or robot_digest(world))
    local.sample(picture(), 3)
    assert len(looked) == 1


def test_a_planner_names_the_robot_of_its_problem():
    source, problem = FakeSampleSource(), draw_problem(Family.UNIFORM, Split.DEMO, 1)
    plan(problem, source, PlannerSettings(seed=3), SampleRequest(SampleQuery(40, 3)))
    assert source.requests[0].query.robot == robot_digest(default_world())
