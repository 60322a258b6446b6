"""A sweep on a real Ray and a real MLflow server, and its command line."""

import json
from pathlib import Path

import pytest
from mlflow import MlflowClient

from cspace.bundle import Bundle
from services.names import EXPERIMENT
from tests.contracts.mlflow_server import mlflow_server
from tests.training.clusters.test_pipeline import submit
from training.sweep import main


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--grid", "seed=[0, 1, 0]"], "a value twice"),
        (["--grid", "sede=[0, 1]"], "sede"),
        (["--grid", "global.steps=[5, 0]"], "global.steps"),
        ([], "one axis or more"),
    ],
)
def test_a_grid_that_cannot_be_trained_ends_before_anything_starts(arguments, message, capsys):
    assert main(["--job", "seeds", "--preset", "smoke", *arguments]) == 2
    assert message in capsys.readouterr().err


@pytest.mark.e2e
@pytest.mark.slow
@pytest.mark.timeout(600)
def test_a_sweep_trains_every_point_once_and_goes_on_in_a_grid_that_has_grown(tmp_path_factory):
    data = tmp_path_factory.mktemp("data")
    command = ["--job", "counts", "--preset", "smoke", "--scenarios", "2", "--sort", "coverage"]
    with mlflow_server(tmp_path_factory.mktemp("mlflow")) as uri:
        first = submit(uri, data, *command, "--grid", "clusters.count=[1, 2]", script="sweep.py")
        marks = {path: path.stat().st_mtime_ns for path in data.glob("jobs/*/*/*/outcome.json")}
        grown = ["--grid", "clusters.count=[1, 2]", "--grid", "seed=[0]"]
        other = submit(uri, data, *command, *grown, script="sweep.py")
        again = submit(uri, data, *command, "--grid", "clusters.count=[1, 2, 3]", script="sweep.py")
        client = MlflowClient(tracking_uri=uri)
        experiment = client.get_experiment_by_name(EXPERIMENT).experiment_id
        children = client.search_runs([experiment], f"tags.mlflow.parentRunId = '{first['run_id']}'")
        parent = client.get_run(first["run_id"])
        versions = client.search_model_versions()
        tables = [entry.path for entry in client.list_artifacts(first["run_id"])]
    assert first["failed"] == 0
    assert sorted(row["clusters.count"] for row in first["points"]) == ["1", "2"]
    covered = [float(row["coverage"]) for row in again["points"]]
    assert covered == sorted(covered, reverse=True)
    # Two points more with a seed of their own, one with a further count, and the first two as they were.
    runs = {row["run"] for found in (first, other, again) for row in found["points"]}
    assert {child.info.run_id for child in children} == runs
    assert len(runs) == 5
    assert again["run_id"] == other["run_id"] == first["run_id"]
    assert {row["run"] for row in first["points"]} < {row["run"] for row in again["points"]}
    assert len(marks) == 9
    assert {path: path.stat().st_mtime_ns for path in marks} == marks
    assert {child.info.status for child in children} == {parent.info.status} == {"FINISHED"}
    assert all(child.data.metrics["validation_coverage"] >= 0 for child in children)
    assert len(list((data / "datasets").iterdir())) == 1
    assert list(versions) == []
    assert "sweep.md" in tables
    commands = {Bundle.load(path).spec.provenance.command for path in data.glob("jobs/*/bundle")}
    single = "python training/cluster_train.py --preset smoke --set clusters.count="
    assert {single + "1", single + "2", single + "3", f"{single}1 --set seed=0"} < commands
    results = [json.loads(path.read_text()) for path in Path(data, "sweeps", "counts", "results").iterdir()]
    assert {row["result"]["state"] for row in results} == {"finished"}
