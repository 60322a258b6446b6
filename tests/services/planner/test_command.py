import pytest

from services.planner import __main__ as command
from tests.fakes.sample_server import sample_server
from tests.fakes.sample_source import FakeSampleSource

UNIFORM = ["--family", "uniform", "--seed", "7"]
DEAD = ["--api", "http://127.0.0.1:9"]


@pytest.fixture
def api():
    with sample_server(FakeSampleSource()) as server:
        yield ["--api", server.url]


def test_a_solved_problem_prints_a_table_draws_a_figure_and_returns_0(api, tmp_path, capsys):
    figure = tmp_path / "plan.png"
    assert command.main([*api, *UNIFORM, "--plot", str(figure)]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert lines[0].startswith("problem  uniform, seed 7, 2 joints")
    assert lines[1].startswith("samples  300 from pretrained/0")
    names = [line.split("  ")[0] for line in lines[4:7]]
    assert names == ["RRT, learned", "RRT, uniform", "RRTConnect, uniform"]
    assert figure.stat().st_size > 10_000
    assert lines[-1].endswith(str(figure))


def test_a_dead_server_is_reported_and_the_problem_solved_uniformly(capsys):
    assert command.main([*DEAD, *UNIFORM]) == 0
    out = capsys.readouterr().out
    assert "none, going on with uniform samples" in out
    assert "http://127.0.0.1:9" in out
    assert "RRT, no samples" in out


def test_a_problem_without_a_path_returns_1(capsys):
    assert command.main([*DEAD, "--family", "disconnected", "--time-limit", "0.05"]) == 1
    assert "limit was reached" in capsys.readouterr().out


@pytest.mark.parametrize("arguments", [["--plot", "plan.gif"], ["--api", "nonsense"]], ids=" ".join)
def test_a_wrong_value_returns_2_and_is_named(arguments, capsys):
    assert command.main([*DEAD, *UNIFORM, *arguments]) == 2
    assert capsys.readouterr().err.startswith("error: ")


@pytest.mark.parametrize(
    "arguments",
    [
        ["--family", "wide"],
        ["--planner", "RRTConnect"],
        ["--time-limit", "0"],
        ["--seed", str(2**64)],
    ],
    ids=" ".join,
)
def test_wrong_usage_leaves_with_2(arguments, capsys):
    with pytest.raises(SystemExit) as left:
        command.main(arguments)
    assert left.value.code == 2
    assert "usage" in capsys.readouterr().err


def test_a_refused_request_returns_2_with_the_server_s_words(api, capsys):
    assert command.main([*api, *UNIFORM, "--model", "nobody/1"]) == 2
    assert "No such model" in capsys.readouterr().err
