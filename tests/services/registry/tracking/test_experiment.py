"""What the experiment's page says, and its saved views."""

import json

from mlflow import MlflowClient

from services.registry.tracking.experiment import NOTE, TRAINING, VIEW, VIEWS, described
from services.registry.tracking.mlflow_tracking import MlflowTracking
from tests.contracts.mlflow_warnings import MLFLOW_WARNINGS

pytestmark = MLFLOW_WARNINGS


def test_every_view_has_an_address_its_search_and_its_columns():
    tags = described("7")
    for view in VIEWS:
        state = json.loads(tags[f"{VIEW}{view.name}"])
        assert state["searchFilter"] == view.search
        assert {f"tags.`{name}`" for name in view.tags} <= set(state["selectedColumns"])
        assert {f"metrics.`{name}`" for name in view.metrics} <= set(state["selectedColumns"])
        assert f"#/experiments/7/runs?{TRAINING}&viewStateShareKey={view.name}" in tags[NOTE]
    assert tags["mlflow.experimentKind"] == "custom_model_development"


def test_the_searches_are_ones_that_mlflow_understands(tmp_path):
    uri = f"sqlite:///{tmp_path / 'mlflow.db'}"
    tracking, client = MlflowTracking(uri), MlflowClient(tracking_uri=uri)
    made = {}
    for stage in ("cluster-train", "local", "evaluation", "planning-benchmark", "other"):
        with tracking.start("views", stage, tags={"stage": stage}) as run:
            made[run.run_id] = stage
    experiment = client.get_experiment_by_name("views")
    found = {
        view.name: [
            made[run.info.run_id] for run in client.search_runs([experiment.experiment_id], view.search)
        ]
        for view in VIEWS
    }
    assert found == {
        "jobs": ["cluster-train"],
        "trials": ["local"],
        "evaluations": ["evaluation"],
        "planning": ["planning-benchmark"],
    }


def test_what_somebody_wrote_onto_the_page_stays(tmp_path):
    uri = f"sqlite:///{tmp_path / 'mlflow.db'}"
    client = MlflowClient(tracking_uri=uri)
    client.create_experiment("own", tags={NOTE: "ours"})
    MlflowTracking(uri).start("own", "run").finish()
    tags = client.get_experiment_by_name("own").tags
    assert tags[NOTE] == "ours"
    assert f"{VIEW}jobs" in tags
