from dataclasses import fields, replace

import pandas as pd
import pytest

from cspace.errors import ConfigError, EvaluationError, StorageError
from cspace.worlds import workshop_of
from cspace.worlds.planar.planning.problems import Family
from cspace.worlds.planar.world import PlanarWorld
from services.evaluator.benchmark.arms import pick, table, units
from services.evaluator.benchmark.sources import SourceSpec
from services.evaluator.benchmark.store import (
    DESCRIPTIONS,
    RUNS,
    Run,
    RunStore,
    complete,
    finite,
    write_parquet,
)

ARMS = pick(table(["way"], 1.0), ["RRT, way, 70 %"])
WAY = SourceSpec("way", "a" * 64, with_ends=True, model="path-sampler/3", url="http://127.0.0.1:1")


FAMILIES = workshop_of(PlanarWorld()).families


def test_runs_come_back_as_they_were(tmp_path, setting, make_run):
    store = RunStore.open(tmp_path / "out", setting, ARMS, [WAY])
    runs = [
        make_run(problem=1, cost_s=(0.1, 0.2), cost_length_rad=(3.0, 2.0)),
        make_run(solved=False, epsilon_sigma=(0.0, 0.5)),
    ]
    store.append(runs)
    assert store.runs() == [runs[1], runs[0]]
    assert store.done() == {("narrow", 0, 0, "RRT, uniform"), ("narrow", 1, 0, "RRT, uniform")}


def test_what_a_killed_process_left_of_a_line_is_dropped_and_done_again(tmp_path, setting, make_run):
    store = RunStore.open(tmp_path, setting, ARMS, [WAY])
    store.append([make_run()])
    with (tmp_path / RUNS).open("a") as file:
        file.write(make_run(problem=1).to_json()[:100])
    again = RunStore.open(tmp_path, setting, ARMS, [WAY])
    again.append([make_run(problem=2)])
    assert [run.problem for run in again.runs()] == [0, 2]
    left = list(units({Family.NARROW: 3}, 1, ARMS[:1], again.done(), FAMILIES))
    assert [unit.index for unit in left] == [1]


def test_runs_of_another_setting_arm_or_model_are_refused(tmp_path, setting):
    RunStore.open(tmp_path, setting, ARMS, [WAY])
    others = [
        (replace(setting, seed=1), ARMS, WAY, "another setting"),
        (setting, [replace(ARMS[1], range_rad=2.0)], WAY, "another arm named RRT, way"),
        (setting, ARMS, replace(WAY, digest="b" * 64), "another sampler named way"),
    ]
    for other_setting, arms, spec, words in others:
        with pytest.raises(ConfigError, match=words):
            RunStore.open(tmp_path, other_setting, arms, [spec])


def test_further_arms_and_samplers_may_join(tmp_path, setting):
    RunStore.open(tmp_path, setting, ARMS, [WAY])
    more = pick(table(["flow"], 1.0), ["RRT, flow, 70 %"])
    store = RunStore.open(tmp_path, setting, more, [replace(WAY, name="flow", digest="c" * 64)])
    assert set(store.manifest()["arms"]) == {"RRT, uniform", "RRT, way, 70 %", "RRT, flow, 70 %"}
    assert set(store.manifest()["samplers"]) == {"way", "flow"}
    # What times depend on is told for both commands.
    sessions = store.manifest()["sessions"]
    assert len(sessions) == 2
    assert all(session["packages"]["ompl"] for session in sessions)


def test_a_line_that_is_no_run_and_a_folder_that_is_a_file_are_errors(tmp_path, setting):
    with pytest.raises(EvaluationError, match="can not be read"):
        Run.from_json('{"iterations": 3}')
    (tmp_path / "file").write_text("")
    with pytest.raises(StorageError):
        RunStore.open(tmp_path / "file", setting, ARMS, [])


def test_only_problems_that_all_arms_of_a_family_have_run_are_compared(make_run):
    runs = [make_run(problem=0), make_run(problem=1), make_run(problem=1, arm="b")]
    other = make_run(problem=0, family="uniform")
    assert complete([*runs, other]) == [*runs[1:], other]
    with pytest.raises(EvaluationError, match="all arms"):
        complete([make_run(problem=0), make_run(problem=1, arm="b")])


def test_problems_without_a_path_have_no_optimising_arms():
    arms = pick(table([], 1.0), ["optimising", "uniform"])
    (unit,) = units({Family.DISCONNECTED: 1}, 1, arms, set(), FAMILIES)
    assert all(arm.stop_at_first for arm in unit.arms)
    (unit,) = units({Family.NARROW: 1}, 1, arms, set(), FAMILIES)
    assert unit.arms == arms


def test_pandas_reads_the_table_and_its_columns_are_described(tmp_path, make_run):
    runs = [make_run(cost_s=(0.1, 0.2)), make_run(arm="b", sampler="way", solved=False)]
    write_parquet(runs, tmp_path / "runs.parquet")
    found = pd.read_parquet(tmp_path / "runs.parquet")
    assert list(found.columns) == [field.name for field in fields(Run)] == list(DESCRIPTIONS)
    assert found["iterations"].tolist() == [100, 100]
    assert found["solved"].tolist() == [True, False]
    assert found["length_rad"].isna().tolist() == [False, True]
    assert found["sampler"].isna().tolist() == [True, False]
    assert list(found["cost_s"][0]) == [0.1, 0.2]
    assert len(found["cost_s"][1]) == 0


def test_numbers_that_json_lacks_become_nothing():
    assert [finite(value) for value in (1.5, float("inf"), float("nan"))] == [1.5, None, None]
