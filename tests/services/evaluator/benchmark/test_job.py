"""A small real benchmark from its samplers to its files."""

import json
from dataclasses import replace

import pandas as pd
import pytest

from cspace.worlds.planar.problems import Family
from services.evaluator import __main__ as evaluator
from services.evaluator.benchmark import __main__ as command
from services.evaluator.benchmark.job import (
    RUNS,
    Request,
    packed_bundle,
    processes,
    run_benchmark,
    run_unit,
)
from services.evaluator.benchmark.variants import Protocol, Unit, pick, table
from tests.fakes.benchmark import run_here
from tests.fakes.registry import FakeTracking

VARIANTS = ("RRT, way, 70 %", "own RRT-Connect, way, 70 %")
TABLE = table(Protocol.FAMILIES, ["way"])
PROBLEMS = {Family.UNIFORM: 2, Family.DISCONNECTED: 1}
# What two runs of the same benchmark may differ in.
TIMES = ["solve_s", "state_check_s", "request_s", "total_s"]


def silent(line: str) -> None:
    """Nobody listens."""


@pytest.fixture(scope="module")
def make_request(path_folder):
    def make(out, setting, *names, **changes) -> Request:
        short = replace(setting, max_iterations=500)
        request = Request(
            out, short, PROBLEMS, 1, pick(TABLE, names or VARIANTS), (("way", packed_bundle(path_folder)),)
        )
        return replace(request, **changes)

    return make


def numbers(folder) -> list[dict]:
    lines = [json.loads(line) for line in (folder / RUNS).read_text().splitlines()]
    kept = [{name: value for name, value in line.items() if name not in TIMES} for line in lines]
    return sorted(kept, key=lambda line: (line["family"], line["problem"], line["variant"]))


def test_every_variant_solves_the_same_problem_with_the_same_seed(setting, path_folder):
    variants = pick(TABLE, VARIANTS)
    unit = Unit(Family.NARROW, 0, tuple((one, 0) for one in variants))
    rows = {row["variant"]: row for row in run_unit(unit, (setting, (("way", packed_bundle(path_folder)),)))}
    assert set(rows) == {one.name for one in variants}
    assert len({row["seed"] for row in rows.values()}) == 1
    for row in rows.values():
        assert row["solved"]
        assert row["total_s"] == row["request_s"] + row["solve_s"]
        # The planner drew what the model sent.
        assert (row["learned_drawn"] > 0) == (row["sampler"] == "way") == (row["request_s"] > 0.0)


@pytest.mark.slow
def test_a_benchmark_leaves_table_report_figures_and_a_run(tmp_path, setting, make_request):
    lines, tracking = [], FakeTracking()
    results = run_benchmark(make_request(tmp_path, setting), run_here, lines.append, tracking)
    assert results.summary["family"].unique().tolist() == sorted(PROBLEMS, key=str)
    files = {path.relative_to(tmp_path).as_posix() for path in tmp_path.rglob("*.*") if path.is_file()}
    names = {"manifest.json", "report.md", "runs.parquet", "figures/success.png"}
    assert files - {".gitignore", RUNS} == names
    report = (tmp_path / "report.md").read_text()
    assert report.startswith("# Planning benchmark")
    for words in ("![figures/success.png]", "## Work: disconnected"):
        assert words in report
    frame = pd.read_parquet(tmp_path / "runs.parquet")
    # Two variants and their bases, on three problems.
    assert len(frame) == 3 * 4
    assert not frame.loc[frame["family"] == "disconnected", "solved"].any()
    (run,) = tracking.runs.values()
    assert run.status == "FINISHED"
    assert set(run.artifacts) == names | {"tables/variants.json"}
    assert (run.tags["protocol"], run.tags["stage"]) == ("families", "planning-benchmark")
    assert run.tags["mlflow.note.content"] == results.note()
    assert run.params["samplers.way"] == make_request(tmp_path, setting).models[0][1].digest
    assert run.history["uniform/RRT_way_70/solved"][0][1] == 1.0
    assert any(line.startswith("logged as run") for line in lines)


def test_what_is_done_is_not_run_again(tmp_path, setting, make_request):
    lines = []

    def stopped(*given):
        yield next(run_here(*given))
        raise KeyboardInterrupt

    for _ in range(2):
        with pytest.raises(KeyboardInterrupt):
            run_benchmark(make_request(tmp_path, setting), stopped, lines.append)
    assert ["3 units to do" in lines[0], "2 units to do" in lines[-1]] == [True, True], lines


@pytest.mark.slow
def test_a_benchmark_that_was_stopped_goes_on_and_ends_with_the_same_numbers(tmp_path, setting, make_request):
    whole = make_request(tmp_path / "whole", setting)
    run_benchmark(whole, processes(2), silent)

    def stopped(*given):
        yield next(run_here(*given))
        raise KeyboardInterrupt

    broken = replace(whole, out=tmp_path / "broken")
    with pytest.raises(KeyboardInterrupt):
        run_benchmark(broken, stopped, silent)
    # A process that was killed while it wrote leaves half a line.
    with (broken.out / RUNS).open("a") as file:
        file.write('{"protocol": "fam')
    lines = []
    run_benchmark(broken, run_here, lines.append)
    assert "2 units to do" in lines[0]
    assert numbers(broken.out) == numbers(whole.out)
    # A variant that joins is run alone.
    run_benchmark(make_request(broken.out, setting, "RRT, way, 100 %", *VARIANTS), run_here, silent)
    assert len(numbers(broken.out)) == len(numbers(whole.out)) + 3


@pytest.mark.slow
def test_the_command_runs_and_goes_on_and_refuses_another_setting(tmp_path, path_folder, capsys):
    given = [
        "planning", "--out", str(tmp_path), "--bundle", f"way={path_folder}", "--family", "uniform",
        "--problems", "2", "--variants", "RRT, way, 70 %", "--processes", "2", "--no-mlflow",
    ]  # fmt: skip
    assert evaluator.main(given, {}) == 0
    assert "2 units to do" in capsys.readouterr().out
    assert evaluator.main(given, {}) == 0
    out = capsys.readouterr().out
    assert "0 units to do" in out
    assert "| RRT, way, 70 % " in out
    assert evaluator.main([*given, "--seed", "1"], {}) == 2
    assert "another setting" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["--variants", "nothing"], "no such variant"),
        (["--family", "wide"], "no such family"),
        (["--bundle", "a=x", "--bundle", "a=y"], "share a name"),
    ],
)
def test_a_wrong_request_ends_with_2_before_anything_runs(tmp_path, arguments, words, capsys):
    given = ["--out", str(tmp_path / "out"), "--no-mlflow", *arguments]
    assert command.main(given, {}) == 2
    assert words in capsys.readouterr().err
    assert not (tmp_path / "out").exists()


def test_a_bundle_that_is_none_ends_with_1_and_no_tracking_server_with_2(tmp_path, capsys):
    given = ["--out", str(tmp_path / "out"), "--bundle", f"x={tmp_path}"]
    assert command.main([*given, "--no-mlflow"], {}) == 1
    assert command.main(given, {}) == 2
    assert "MLFLOW_TRACKING_URI" in capsys.readouterr().err
