"""What a run holds, read back from the fake and from MLflow in the same form."""

import json
from dataclasses import dataclass
from typing import Any

from mlflow import MlflowClient
from mlflow.entities import FileInfo

from tests.fakes.registry import FakeTracking


@dataclass(frozen=True)
class RunRecord:
    """One run; ``history`` is (step, value) for each metric, ``inputs`` name, digest, source and context."""

    name: str
    status: str
    parent_run_id: str | None
    params: dict[str, str]
    tags: dict[str, str]
    history: dict[str, list[tuple[int, float]]]
    artifacts: frozenset[str]
    inputs: list[tuple[str, str, str, str]]


def read_fake(tracking: FakeTracking, run_id: str) -> RunRecord:
    run = tracking.runs[run_id]
    inputs = [(one["name"], one["digest"], one["source"], one["context"]) for one in run.inputs]
    return RunRecord(
        run.name,
        run.status,
        run.parent_run_id,
        run.params,
        run.tags,
        {name: sorted(points) for name, points in run.history.items()},
        frozenset(run.artifacts),
        inputs,
    )


def read_mlflow(client: MlflowClient, run_id: str) -> RunRecord:
    run = client.get_run(run_id)
    history = {
        name: sorted((point.step, point.value) for point in client.get_metric_history(run_id, name))
        for name in run.data.metrics
    }
    return RunRecord(
        run.info.run_name,
        run.info.status,
        run.data.tags.get("mlflow.parentRunId"),
        run.data.params,
        run.data.tags,
        history,
        frozenset(_files(client, run_id, None)),
        [_input(one) for one in run.inputs.dataset_inputs],
    )


def _files(client: MlflowClient, run_id: str, folder: str | None) -> list[str]:
    found: list[str] = []
    entry: FileInfo
    for entry in client.list_artifacts(run_id, folder):
        found += _files(client, run_id, entry.path) if entry.is_dir else [entry.path]
    return found


def _input(entry: Any) -> tuple[str, str, str, str]:
    tags = {tag.key: tag.value for tag in entry.tags}
    digest = json.loads(entry.dataset.profile)["sha256"]
    # The digest that MLflow shows is the beginning of the whole one.
    assert digest.startswith(entry.dataset.digest)
    source = json.loads(entry.dataset.source)["uri"]
    return entry.dataset.name, digest, source, tags["mlflow.data.context"]
