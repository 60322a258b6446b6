"""The planner command that lets an API plan, against the app."""

from functools import partial

import pytest

from services.planner import __main__ as command
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
