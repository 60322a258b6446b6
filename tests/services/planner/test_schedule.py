"""The epsilon schedule of algorithm 3: its union reaches the planner in equal shares, for path models too."""

import json
from pathlib import Path

import httpx
import numpy as np
import pytest

from cspace.bundle import Bundle
from cspace.query import SampleQuery
from cspace.worlds.planar.render import render
from inference_api.app import create_app
from inference_api.settings import ApiSettings
from services.planner import __main__ as command
from services.planner.client import SamplingClient
from services.planner.planning import PAPER_SCHEDULE, SampleRequest, plan_with_api
from services.planner.samples import LocalSampler
from services.planner.settings import PlannerSettings
from tests.bundles import write_tiny_bundle
from tests.fakes.sample_server import sample_server
from tests.inference_api.client import ApiClient, running

# Three samples for each value and the remainder of two for the first.
N = 14
SHARES = (slice(0, 5), slice(5, 8), slice(8, 11), slice(11, 14))


@pytest.fixture(scope="module")
def path_bundle(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_tiny_bundle(tmp_path_factory.mktemp("schedule") / "path", kind="path")


@pytest.fixture
def handler(path_bundle, tmp_path):
    """The API's own handler in this process."""
    settings = ApiSettings(
        registry_uri=None, model_cache=tmp_path / "cache", model_poll_s=3600.0, pretrained_model=path_bundle
    )
    with running(create_app(settings, None)) as api:
        yield api


def client_of(api: ApiClient) -> SamplingClient:
    def passed_on(request: httpx.Request) -> httpx.Response:
        answer = api.post(request.url.path, content=request.read(), headers=dict(request.headers))
        return httpx.Response(answer.status_code, headers=answer.headers, content=answer.content)

    return SamplingClient("http://localhost:1", transport=httpx.MockTransport(passed_on))


def one_value(path_bundle, problem, epsilon):
    """What the model draws when the whole batch has one value: eta depends on the count alone."""
    options = {"start": problem.start, "goal": problem.goal, "epsilon_sigma": (epsilon,)}
    return Bundle.load(path_bundle).sample(render(problem.scenario), N, 3, **options).samples


def test_the_union_comes_through_the_api_in_equal_shares_and_in_its_order(handler, path_bundle, blocked):
    request = SampleRequest(SampleQuery(N, 3, PAPER_SCHEDULE), with_ends=True)
    settings = PlannerSettings(goal_bias=0.0, range_rad=100.0, max_iterations=N)
    with client_of(handler) as client:
        plan = plan_with_api(blocked, client, settings, request, 0.0, keep_tree=True)
    samples = plan.batch.samples
    assert len(samples) == N
    for share, epsilon in zip(SHARES, PAPER_SCHEDULE, strict=True):
        alone = one_value(path_bundle, blocked, epsilon)[share]
        np.testing.assert_allclose(samples[share], alone, atol=1e-5)
        if epsilon:
            assert not np.allclose(alone, one_value(path_bundle, blocked, 0.0)[share], atol=1e-2)
    vertices = plan.result.tree.vertices
    drawn = vertices[np.any(vertices != blocked.start, axis=1)]
    assert len(drawn) == len(vertices) - 1 > 0
    nearest = np.min(np.abs(drawn[:, None] - samples[None].astype(np.float64)).sum(axis=2), axis=1)
    assert np.all(nearest < 1e-6)


def test_the_command_sends_schedule_and_ends_to_a_path_model(path_bundle, capsys):
    queries = []

    class Noted(LocalSampler):
        def answer(self, picture, query, model=None):
            queries.append(query)
            return super().answer(picture, query, model)

    arguments = ["--family", "uniform", "--seed", "7", "--n", str(N), "--path-model", "--json"]
    schedule = [str(value) for value in PAPER_SCHEDULE]
    with sample_server(Noted(path_bundle)) as server:
        command.main(["--api", server.url, *arguments, "--epsilon-sigma", *schedule])
    outcome = json.loads(capsys.readouterr().out)
    assert outcome["samples"]["count"] == N
    assert queries[0].epsilon_sigma == PAPER_SCHEDULE
    assert list(queries[0].start) == outcome["problem"]["start"]
    assert list(queries[0].goal) == outcome["problem"]["goal"]
