"""Who plans for one robot takes no other one's samples."""

import httpx
import pytest

from cspace.bundle import samples as judging
from cspace.errors import ConfigError, SamplerAnswerError, SamplerError, SamplerUnavailableError
from cspace.query import SampleQuery
from cspace.simulator import Split
from cspace.worlds import default_world, examples, robot_digest
from cspace.worlds.planar.problems import Family, draw_problem
from services.planner.client import ClientSource, RetryPolicy, SamplingClient
from services.planner.planning import SampleRequest, plan
from services.planner.samples import LocalSampler
from services.planner.settings import PlannerSettings
from tests.bundles import picture, write_tiny_bundle
from tests.fakes.sample_server import read_form
from tests.fakes.sample_source import FakeSampleSource
from tests.services.planner.clients import KINDS, ask
from tests.services.planner.hostile_server import GOOD_BODY, GOOD_HEADERS

PNG = b"\x89PNG picture"
TWO, THREE, *_ = (robot_digest(world) for world in examples().values())


class Server:
    """Answers with these headers beside the usual ones."""

    def __init__(self, **headers: str) -> None:
        self.requests: list[dict[str, list[bytes]]] = []
        self._headers = headers

    def handle(self, request: httpx.Request) -> httpx.Response:
        self.requests.append(fields := read_form(request.headers["content-type"], request.read()))
        headers = {**GOOD_HEADERS, "X-Seed": fields["seed"][0].decode(), **self._headers}
        return httpx.Response(200, headers=headers, content=GOOD_BODY)

    @property
    def robots(self) -> list[bytes | None]:
        return [fields.get("robot", [None])[0] for fields in self.requests]


def batch_of(server, robot=None, kind="sync", **question):
    options = {"transport": httpx.MockTransport(server.handle), "robot": robot}
    return ask(kind, "http://test:1", PNG, 2, options=options, seed=7, **question)


def test_the_clients_robot_goes_with_every_request_and_a_requests_own_before_it():
    server = Server(**{"X-Robot": TWO, "X-Alias-Confirmed": "false"})
    batch = batch_of(server, TWO, times=2)
    assert (batch.robot, batch.alias_confirmed) == (TWO, False)
    options = {"transport": httpx.MockTransport(server.handle), "robot": THREE}
    ask("sync", "http://test:1", PNG, 2, options=options, seed=7, robot=TWO)
    assert server.robots == [TWO.encode()] * 3


def test_without_a_robot_nothing_is_sent_and_any_is_taken():
    server = Server(**{"X-Robot": THREE})
    assert batch_of(server).robot == THREE
    assert server.robots == [None]


@pytest.mark.parametrize("kind", KINDS)
def test_an_answer_for_another_robot_can_not_be_used(kind):
    with pytest.raises(SamplerAnswerError, match="another robot"):
        batch_of(Server(**{"X-Robot": THREE}), TWO, kind)


@pytest.mark.parametrize("headers", [{"X-Robot": "two"}, {"X-Robot": ""}, {"X-Alias-Confirmed": "maybe"}])
def test_headers_that_can_not_be_are_refused(headers):
    with pytest.raises(SamplerAnswerError, match=next(iter(headers)).lower()):
        batch_of(Server(**headers))


def test_a_robot_that_is_no_digest_is_refused():
    with pytest.raises(ConfigError, match="digest"):
        SamplingClient("http://test:1", robot="two-link")


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


def test_a_fallback_of_another_robot_does_not_stand_in(tmp_path):
    local = ClientSource(LocalSampler(write_tiny_bundle(tmp_path / "bundle")))
    policy = RetryPolicy(attempts=1)
    with SamplingClient("http://127.0.0.1:9", policy=policy, fallback=local, robot=THREE) as client:
        with pytest.raises(SamplerUnavailableError):
            client.sample(picture(), 3)
        assert client.sample(picture(), 3, robot=TWO).fallback


def test_a_planner_names_the_robot_of_its_problem():
    source, problem = FakeSampleSource(), draw_problem(Family.UNIFORM, Split.DEMO, 1)
    plan(problem, source, PlannerSettings(seed=3), SampleRequest(SampleQuery(40, 3)))
    assert source.requests[0].query.robot == robot_digest(default_world())
