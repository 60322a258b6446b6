from dataclasses import replace

import pandas as pd
import pytest

from cspace.errors import ConfigError, EvaluationError, StorageError
from cspace.worlds.planar.problems import Family
from services.evaluator.benchmark.arms import Protocol, pick, table
from services.evaluator.benchmark.runs import RUNS, SAMPLE_COLUMNS, RunStore, frame_of, key_of
from services.evaluator.benchmark.samples import sample_units
from services.evaluator.benchmark.sources import SourceSpec
from services.evaluator.benchmark.summary import Paired

ARMS = pick(table(["way"], 1.0), ["RRT, way, 70 %"])
WAY = SourceSpec("way", "a" * 64, with_ends=True, model="path-sampler/3", url="http://127.0.0.1:1")


def test_runs_come_back_as_they_were(tmp_path, setting, make_run):
    store = RunStore(tmp_path / "out", setting, ARMS, [WAY])
    runs = [
        make_run(problem=1, cost_s=[0.1, 0.2], cost_length_rad=[3.0, 2.0]),
        make_run(solved=False, epsilon_sigma=[0.0, 0.5]),
    ]
    store.append(runs)
    assert store.rows() == runs
    assert store.keys() == {("narrow", 0, 0, 0, "RRT, uniform"), ("narrow", 1, 0, 0, "RRT, uniform")}
    assert store.frame([key_of(runs[0])])["problem"].tolist() == [1]
    assert store.frame(store.keys())["problem"].tolist() == [0, 1]


def test_what_a_killed_process_left_of_a_line_is_dropped_and_done_again(tmp_path, setting, make_run):
    store = RunStore(tmp_path, setting, ARMS, [WAY])
    store.append([make_run()])
    with (tmp_path / RUNS).open("a") as file:
        file.write('{"protocol": "families", "family": "narr')
    again = RunStore(tmp_path, setting, ARMS, [WAY])
    again.append([make_run(problem=2)])
    assert [run["problem"] for run in again.rows()] == [0, 2]
    units = sample_units(setting, {Family.NARROW: 3}, 1, ARMS[:1])
    assert [unit.index for unit in units if unit.without(again.keys()).todo] == [1]


def test_runs_of_another_setting_arm_or_model_are_refused(tmp_path, setting):
    RunStore(tmp_path, setting, ARMS, [WAY])
    others = [
        (replace(setting, seed=1), ARMS, WAY, "another setting"),
        (setting, [replace(ARMS[1], range_rad=2.0)], WAY, "another arm named RRT, way"),
        (setting, ARMS, replace(WAY, digest="b" * 64), "another sampler named way"),
    ]
    for other_setting, arms, spec, words in others:
        with pytest.raises(ConfigError, match=words):
            RunStore(tmp_path, other_setting, arms, [spec])


def test_further_arms_and_samplers_may_join(tmp_path, setting):
    RunStore(tmp_path, setting, ARMS, [WAY])
    more = pick(table(["flow"], 1.0), ["RRT, flow, 70 %"])
    store = RunStore(tmp_path, setting, more, [replace(WAY, name="flow", digest="c" * 64)])
    assert set(store.manifest["arms"]) == {"RRT, uniform", "RRT, way, 70 %", "RRT, flow, 70 %"}
    assert set(store.manifest["samplers"]) == {"way", "flow"}
    # What times depend on is kept for both commands.
    sessions = store.manifest["sessions"]
    assert len(sessions) == 2
    assert all(session["packages"]["ompl"] for session in sessions)


def test_a_line_that_is_no_run_and_a_folder_that_is_a_file_are_errors(tmp_path, setting, make_run):
    row = make_run()
    del row["iterations"]
    with pytest.raises(EvaluationError, match="iterations"):
        frame_of([row], Protocol.FAMILIES)
    (tmp_path / "file").write_text("")
    with pytest.raises(StorageError):
        RunStore(tmp_path / "file", setting, ARMS, [])
    store = RunStore(tmp_path / "out", setting, ARMS, [])
    (tmp_path / "out" / RUNS).write_text("no JSON\n")
    with pytest.raises(EvaluationError, match="can not be read"):
        store.rows()


def test_only_problems_that_all_arms_have_run_equally_often_are_compared(make_run, paired):
    both = [make_run(problem=1, arm=arm, run=run) for arm in ("a", "b") for run in (0, 1)]
    once = [make_run(problem=2, arm=arm) for arm in ("a", "b")]
    found = paired([*both, *once, make_run(problem=3, arm="a")])
    assert found.runs["problem"].unique().tolist() == [1]
    assert (found.problems, found.repeats, found.arms) == (1, 2, ["a", "b"])
    for rows in ([make_run(problem=0), make_run(problem=1, arm="b")], []):
        with pytest.raises(EvaluationError, match="all arms"):
            paired(rows)
    with pytest.raises(EvaluationError, match="no such arm"):
        found.values("another", "iterations")


def test_problems_without_a_path_have_no_optimising_arms(setting):
    arms = pick(table([], 1.0), ["optimising", "uniform"])
    (unit,) = sample_units(setting, {Family.DISCONNECTED: 1}, 1, arms)
    assert all(arm.stop_at_first for arm, _ in unit.todo)
    (unit,) = sample_units(setting, {Family.NARROW: 1}, 1, arms)
    assert tuple(arm for arm, _ in unit.todo) == arms


def test_pandas_reads_the_table_with_empty_values(tmp_path, make_run):
    runs = [make_run(cost_s=[0.1, 0.2]), make_run(arm="b", sampler="way", solved=False)]
    frame_of(runs, Protocol.FAMILIES).to_parquet(tmp_path / "runs.parquet")
    found = pd.read_parquet(tmp_path / "runs.parquet")
    assert list(found.columns) == list(SAMPLE_COLUMNS)
    assert found["iterations"].tolist() == [100, 100]
    assert found["solved"].tolist() == [True, False]
    assert found["length_rad"].isna().tolist() == found["first_iterations"].isna().tolist() == [False, True]
    assert found["sampler"].isna().tolist() == [True, False]
    assert list(found["cost_s"][0]) == [0.1, 0.2]
    assert len(found["cost_s"][1]) == 0
    assert Paired(found[found["arm"] == "b"]).values("b", "length_rad").shape == (1, 1)
