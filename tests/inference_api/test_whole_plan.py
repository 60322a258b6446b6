"""The planner command that lets an API plan, against the app."""

import json
from functools import partial
from types import SimpleNamespace

import httpx
import numpy as np
import pytest

from cspace_client import OutcomeSender
from services.planner import __main__ as command
from services.planner import planning
from services.planner.samples import SamplingClient
from tests.inference_api.client_transports import IntoApp

WHOLE = ["--whole-plan", "--api", "http://localhost", "--family", "uniform", "--seed", "7"]
CAREFUL = ["--model", "cspace-sampler@careful"]


@pytest.fixture
def plan(api, monkeypatch, capsys):
    monkeypatch.setattr(command, "SamplingClient", partial(SamplingClient, transport=IntoApp(api)))

    def run(*arguments: str) -> tuple[int, str, str]:
        code = command.main([*WHOLE, *arguments])
        output = capsys.readouterr()
        return code, output.out, output.err

    return run


def test_a_way_is_told_judged_in_the_scene_and_drawn(plan, tmp_path):
    figure = tmp_path / "plan.png"
    code, out, _ = plan(*CAREFUL, "--plot", str(figure))
    lines = [line.split(maxsplit=1) for line in out.splitlines()]
    assert [first for first, _ in lines] == ["problem", "plan", "path", "truth"]
    assert lines[1][1].startswith("solved by cspace-sampler/5")
    assert code == (0 if lines[3][1].startswith("collision-free") else 1)
    assert figure.stat().st_size > 10_000


@pytest.mark.parametrize("clearance_m", [0.01, -0.01])
def test_the_api_is_told_whether_the_path_collides(plan, monkeypatch, clearance_m):
    told = []

    def take(request: httpx.Request) -> httpx.Response:
        told.extend(json.loads(request.read())["outcomes"])
        return httpx.Response(202)

    checker = SimpleNamespace(clearance=lambda states: np.full(len(states), clearance_m))
    monkeypatch.setattr(planning, "checker_of", lambda _: checker)
    monkeypatch.setattr(command, "OutcomeSender", partial(OutcomeSender, transport=httpx.MockTransport(take)))
    code, _, _ = plan(*CAREFUL, "--outcomes")
    [one] = told
    assert (one["kind"], one["model"], one["executed"]) == ("plan", "cspace-sampler/5", False)
    assert one["success"] is (code == 0) is (clearance_m > 0.0) is not one["collided"]


def test_what_is_not_sure_enough_is_told_with_the_reason_and_returns_1(plan, tmp_path):
    figure = tmp_path / "plan.png"
    code, out, _ = plan(*CAREFUL, "--min-confidence", "1", "--plot", str(figure))
    assert code == 1
    assert "\nreason   the best of 4 paths" in out
    assert "\ntruth" not in out
    assert figure.exists()


def test_a_model_that_believes_nothing_is_wrong_usage(plan):
    code, _, err = plan("--model", "cspace-sampler")
    assert code == 2
    assert "validity head" in err
