import numpy as np
import pytest

from cspace.worlds.planar.problems import Family
from services.evaluator.benchmark.arms import Protocol, Setting, pick, table
from services.evaluator.benchmark.figures import share_until
from services.evaluator.benchmark.job import Request, Results
from services.evaluator.benchmark.report import about, report
from services.evaluator.benchmark.runs import frame_of

ARMS = pick(
    table(["way", "flow"], 1.0), ["RRT, way, 70 %", "RRT, way, 70 %, 10 samples", "RRT*, uniform, optimising"]
)
MANIFEST = {
    "samplers": {
        "way": {"model": "path-sampler/3", "digest": "a" * 64, "transport": "HTTP"},
        "flow": {"model": None, "digest": "b" * 64, "transport": "none"},
    }
}


@pytest.fixture
def results(tmp_path, make_run, setting):
    rows = []
    for problem in range(3):
        for arm in ARMS:
            cost = {
                "cost_s": [0.1],
                "cost_iterations": [9],
                "cost_edge_checks": [9],
                "cost_length_rad": [4.0],
            }
            rows.append(
                make_run(
                    arm=arm.name, group=arm.group.value, planner=arm.planner, sampler=arm.sampler,
                    stop_at_first=arm.stop_at_first, problem=problem, solved=problem < 2,
                    **({} if arm.stop_at_first else cost),
                )
            )  # fmt: skip
    paper = Setting(Protocol.PAPER, setting.split, 0, 1000, 1000, 1.0)
    request = Request(tmp_path, paper, {Family.NARROW: 3}, 1, ARMS, ())
    return Results.of(request, frame_of(rows, Protocol.PAPER))


def test_the_share_solved_rises_with_what_a_run_may_take():
    taken, shares = share_until(np.array([30.0, 10.0, 20.0, 5.0]), np.array([True, True, True, False]))
    assert taken.tolist() == [10.0, 10.0, 20.0, 30.0]
    assert shares.tolist() == [0.0, 0.25, 0.5, 0.75]
    taken, shares = share_until(np.array([5.0]), np.array([False]))
    assert shares.tolist() == [0.0]
    assert len(taken) == 1


def test_every_figure_shows_what_its_name_says(results):
    found = dict(results.figures())
    named = {f"{name}-narrow" for name in ("success", "first-solution", "cost", "samples")}
    assert set(found) == named | {"boxes"}
    for figure in found.values():
        assert all(axes.get_xlabel() for axes in figure.axes)
    success = found["success-narrow"].axes
    assert [axes.get_xlabel() for axes in success] == ["iterations", "edge checks", "request and search (ms)"]
    (line, *_) = success[0].get_lines()
    # Two of three problems.
    assert line.get_ydata()[-1] == pytest.approx(2 / 3)
    unsolved = [text.get_text() for text in found["first-solution-narrow"].axes[0].texts]
    assert unsolved == ["33.3 %", "33.3 %"]


def test_success_against_the_samples_asked_for_has_its_limits(results):
    axes = dict(results.figures())["samples-narrow"].axes[2]
    ((line, _, (bars,)),) = axes.containers
    assert line.get_xydata().tolist() == [[10.0, pytest.approx(2 / 3)]]
    low, high = bars.get_segments()[0][:, 1]
    # Two of three, after Clopper and Pearson.
    assert (low, high) == (pytest.approx(0.0943, abs=1e-4), pytest.approx(0.9916, abs=1e-4))


def test_the_papers_report_has_its_columns_and_success_against_the_samples_asked_for(results):
    facts = about(results.runs, results.request.setting, MANIFEST)
    text = report(results.headline, facts, results.sections, Protocol.PAPER, ["figures/boxes.png"])
    assert text.startswith("Break-even cost of an edge check")
    assert "| RRT, way, 70 % | 4.00 [4.00, 4.00] | 3.00 [3.00, 3.00] | 3.00 [3.00, 3.00] | 0.6667" in text
    assert "| 0.67 [0.09, 0.99] |" in text
    assert "| RRT, way, 70 %, 10 samples | 0.667" in text
    assert "- way: path-sampler/3, digest aaaaaaaaaaaa, transport HTTP." in text
    # A sampler of the folder that was not asked for now.
    assert "- flow" not in text
    assert "![boxes](figures/boxes.png)" in text
