"""A small real benchmark from its samplers to its files."""

import json
from collections.abc import Iterator
from dataclasses import replace

import pandas as pd
import pytest

from cspace.errors import EvaluationError, JobError
from cspace.worlds.planar.problems import Family
from services.evaluator import __main__ as evaluator
from services.evaluator.benchmark import __main__ as command
from services.evaluator.benchmark.arms import pick, table
from services.evaluator.benchmark.execution import processes
from services.evaluator.benchmark.job import Request, run_benchmark
from services.evaluator.benchmark.runs import RUNS
from services.evaluator.benchmark.sources import bundled
from tests.fakes.benchmark import run_here
from tests.fakes.registry import FakeTracking

ARMS = ("RRT, way, 70 %", "own RRT-Connect, way, 70 %", "RRT*, way, 70 %, optimising")
PROBLEMS = {Family.UNIFORM: 2, Family.DISCONNECTED: 1}
# What two runs of the same benchmark may differ in.
TIMES = [
    "solve_s", "state_check_s", "check_s", "plan_s", "request_s", "decode_s", "encode_s", "generate_s",
    "server_s", "transport_s", "total_s", "first_s", "cost_s",
]  # fmt: skip


def silent(line: str) -> None:
    """Nobody listens."""


@pytest.fixture(scope="module")
def make_request(path_folder):
    def make(out, setting, *names, **changes) -> Request:
        arms = pick(table(["way"], 1.0), names or ARMS)
        short = replace(setting, max_iterations=500, optimising_iterations=200)
        specs = (bundled("way", path_folder),)
        return replace(Request(out, short, PROBLEMS, 1, arms, specs, pages=1), **changes)

    return make


@pytest.fixture
def undrawn(monkeypatch):
    """No figures, which take longer than all runs."""
    monkeypatch.setattr("services.evaluator.benchmark.job.sample_figures", lambda *given: ())


def numbers(folder) -> list[dict]:
    lines = [json.loads(line) for line in (folder / RUNS).read_text().splitlines()]
    kept = [{name: value for name, value in line.items() if name not in TIMES} for line in lines]
    return sorted(kept, key=lambda line: (line["family"], line["problem"], line["arm"]))


@pytest.mark.slow
def test_a_benchmark_leaves_table_report_figures_pages_and_a_run(tmp_path, setting, make_request):
    lines, tracking = [], FakeTracking()
    results = run_benchmark(make_request(tmp_path, setting), run_here, lines.append, tracking)
    assert results.summary["family"].unique().tolist() == list(PROBLEMS)
    files = {path.relative_to(tmp_path).as_posix() for path in tmp_path.rglob("*.*") if path.is_file()}
    figures = {"figures/boxes.png"} | {
        f"figures/{name}-uniform.png" for name in ("success", "first-solution", "cost")
    }
    pages = {"pages/page-uniform-00.png", "pages/page-disconnected-00.png"}
    texts = {"manifest.json", "report.md", "comparison.md", "runs.parquet"}
    names = texts | figures | pages
    assert files - {".gitignore"} == names | {RUNS}
    assert "![boxes](figures/boxes.png)" in (tmp_path / "report.md").read_text()
    assert all((tmp_path / name).stat().st_size > 10_000 for name in figures | pages)
    frame = pd.read_parquet(tmp_path / "runs.parquet")
    # Six arms on two problems, and the four of them that do not optimise on one.
    assert len(frame) == 2 * 6 + 4
    assert not frame.loc[frame["family"] == "disconnected", "solved"].any()
    (run,) = tracking.runs.values()
    assert run.status == "FINISHED"
    assert set(run.artifacts) == names | {"tables/arms.json", "tables/arms.parquet"}
    assert run.tags["mlflow.note.content"] == (tmp_path / "comparison.md").read_text()
    assert run.params["samplers.way"] == make_request(tmp_path, setting).specs[0].digest
    assert run.history["uniform/RRT_way_70/solved"][0][1] == 1.0
    table = json.loads(run.artifacts["tables/arms.json"])
    rows = [dict(zip(table["columns"], row, strict=True)) for row in table["data"]]
    close = [row for row in rows if (row["arm"], row["measure"]) == ("RRTstar_way_70_optimising", "close")]
    assert [row["family"] for row in close] == ["uniform"]
    assert close[0]["low"] <= close[0]["value"] <= close[0]["high"]
    assert any(line.startswith("logged as run") for line in lines)


def test_the_report_begins_with_the_break_even_cost(tmp_path, setting, make_request, undrawn):
    few = {Family.UNIFORM: 1, Family.DISCONNECTED: 1}
    results = run_benchmark(make_request(tmp_path, setting, problems=few, pages=0), run_here, silent)
    first, _, text = (tmp_path / "report.md").read_text().partition("\n")
    assert first.startswith("Break-even cost of an edge check")
    assert "uniform, RRT, way, 70 %: " in first
    assert "uniform, own RRT-Connect, way, 70 %: " in first
    assert "disconnected" not in first
    for words in ("transport none", "| RRT, uniform | 0 of 1 |", "## Optimising, uniform"):
        assert words in text
    assert results.terminal().startswith(first)


@pytest.mark.slow
def test_a_benchmark_that_was_stopped_goes_on_and_ends_with_the_same_numbers(tmp_path, setting, make_request):
    whole = make_request(tmp_path / "whole", setting, pages=0)
    run_benchmark(whole, run_here, silent)

    def stopped(*given) -> Iterator:
        yield next(run_here(*given))
        raise KeyboardInterrupt

    broken = replace(whole, out=tmp_path / "broken")
    with pytest.raises(KeyboardInterrupt):
        run_benchmark(broken, stopped, silent)
    kept = numbers(broken.out)
    assert len(kept) == 6
    # A process that was killed while it wrote leaves half a line.
    with (broken.out / RUNS).open("a") as file:
        file.write('{"protocol": "fam')
    lines = []
    run_benchmark(broken, run_here, lines.append)
    assert "2 runs of problems to do" in lines[0]
    assert numbers(broken.out) == numbers(whole.out)
    assert all(line in numbers(broken.out) for line in kept)


def test_an_arm_that_joins_is_run_alone(tmp_path, setting, make_request, undrawn):
    few = {Family.UNIFORM: 1}
    run_benchmark(make_request(tmp_path, setting, "RRT, way, 70 %", problems=few, pages=0), run_here, silent)
    before = numbers(tmp_path)

    def counted(work, *given):
        assert [[arm.name for arm, _ in unit.todo] for unit in work] == [["RRT, way, 100 %"]]
        yield from run_here(work, *given)

    request = make_request(tmp_path, setting, "RRT, way, 100 %", "RRT, way, 70 %", problems=few, pages=0)
    results = run_benchmark(request, counted, silent)
    assert results.summary["arm"].nunique() == 3
    assert [line for line in numbers(tmp_path) if line["arm"] != "RRT, way, 100 %"] == before


def test_without_a_run_there_is_nothing_to_tell(tmp_path, setting, make_request):
    with pytest.raises(EvaluationError, match="all arms"):
        run_benchmark(make_request(tmp_path, setting), lambda *given: iter(()), silent)


@pytest.mark.slow
def test_processes_give_the_same_numbers_and_their_errors_come_back(tmp_path, setting, make_request, undrawn):
    here = make_request(tmp_path / "here", setting, pages=0)
    there = replace(here, out=tmp_path / "there")
    run_benchmark(here, run_here, silent)
    run_benchmark(there, processes(2), silent)
    assert numbers(there.out) == numbers(here.out)
    lying = replace(here, out=tmp_path / "lying", specs=(replace(here.specs[0], digest="0" * 64),))
    with pytest.raises(Exception, match="another model answers"):
        run_benchmark(lying, processes(1), silent)


@pytest.mark.slow
def test_the_command_runs_and_goes_on(tmp_path, path_folder, capsys):
    given = [
        "planning", "--out", str(tmp_path), "--bundle", f"way={path_folder}", "--family", "uniform",
        "--problems", "2", "--arms", "RRT, way, 70 %", "--processes", "2", "--pages", "0", "--no-mlflow",
    ]  # fmt: skip
    assert evaluator.main(given, {}) == 0
    assert "2 runs of problems to do" in capsys.readouterr().out
    assert evaluator.main(given, {}) == 0
    out = capsys.readouterr().out
    assert "0 runs of problems to do" in out
    assert "RRT, way, 70 %" in out
    assert evaluator.main([*given, "--seed", "1"], {}) == 2
    assert "another setting" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["--problems", "0"], "--problems is out of range"),
        (["--runs", "0"], "--runs is out of range"),
        (["--processes", "0"], "--processes is out of range"),
        (["--pages", "-1"], "--pages is out of range"),
        (["--seed", "-1"], "--seed is out of range"),
        (["--time-limit", "0"], "--time-limit is out of range"),
        (["--min-confidence", "1.1"], "--min-confidence is out of range"),
        (["--shares", "0.7", "0"], "--shares is out of range"),
        (["--samples", "20001"], "--samples is out of range"),
        (["--arms", "nothing"], "no such arm"),
        (["--model", "path-sampler@champion"], "behind an API"),
        (["--bundle", "a=x", "--bundle", "a=y"], "share a name"),
    ],
)
def test_a_wrong_request_ends_with_2_before_anything_runs(tmp_path, arguments, words, capsys):
    given = ["--out", str(tmp_path / "out"), "--no-mlflow", *arguments]
    assert command.main(given, {}) == 2
    assert words in capsys.readouterr().err
    assert not (tmp_path / "out").exists()


def test_a_bundle_that_is_none_ends_with_1_and_no_tracking_server_with_2(tmp_path, capsys):
    given = ["--out", str(tmp_path / "out"), "--arms", "RRT, x, 70 %", "--bundle", f"x={tmp_path}"]
    assert command.main([*given, "--no-mlflow"], {}) == 1
    assert command.main(given, {}) == 2
    assert "MLFLOW_TRACKING_URI" in capsys.readouterr().err


def test_the_arms_are_listed(tmp_path, capsys):
    assert (
        command.main(["--out", str(tmp_path), "--model", "w=x", "--arms", "learned", "--list-arms"], {}) == 0
    )
    lines = capsys.readouterr().out.splitlines()
    assert "learned     RRT, w, 70 %" in lines
    assert "uniform     RRT, uniform" in lines


def test_a_process_that_dies_is_told_with_its_remedy(setting, monkeypatch):
    from concurrent.futures.process import BrokenProcessPool

    from services.evaluator.benchmark import execution

    class Dying:
        def __init__(self, *given):
            pass

        def submit(self, *given):
            raise BrokenProcessPool("a child process terminated abruptly")

        def shutdown(self, **given):
            pass

    monkeypatch.setattr(execution, "ProcessPoolExecutor", Dying)
    with pytest.raises(JobError, match="goes on from the runs that it has"):
        list(processes(1)([None], setting, []))


@pytest.mark.parametrize("value", ["inf", "nan", "long"])
def test_an_option_that_is_no_finite_number_is_wrong_use(tmp_path, capsys, value):
    with pytest.raises(SystemExit) as left:
        command.main(["--out", str(tmp_path), "--list-arms", "--time-limit", value], {})
    assert left.value.code == 2
    assert "expected a finite number" in capsys.readouterr().err
