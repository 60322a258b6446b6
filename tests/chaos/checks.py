"""What a job must have left behind, whatever happened to it on its way."""

from collections import Counter
from dataclasses import dataclass
from pathlib import Path

from mlflow import MlflowClient
from mlflow.entities import LoggedModelStatus, Run

from cspace.bundle import Bundle
from services.names import EXPERIMENT, MODEL_NAME
from services.registry.models import ModelRegistry
from training.jobs.launch import FINAL
from training.models.checkpoint import read_checkpoint

STAGES = {
    "vae": "pictures",
    "validity": "pictures",
    "gate": "gate",
    "local-0": "local",
    "local-1": "local",
    "global": "global",
}


@dataclass(frozen=True)
class Left:
    """What a finished job left.

    Args:
        run_id: of the parent run.
        version: in the registry.
        weights: bytes by trial.
        digests: of the bundle's graphs by name.
    """

    run_id: str
    version: int
    weights: dict[str, bytes]
    digests: dict[str, str]


def left_behind(
    uri: str,
    data: Path,
    result: dict[str, object],
    steps: dict[str, int],
    every: int,
    model: str = MODEL_NAME,
) -> Left:
    """Look at everything; an assertion names what was lost or doubled.

    Args:
        uri: of the tracking server.
        data: the jobs' data folder.
        result: the job's own last line.
        steps: of each trial.
        every: steps between two points of a metric.
        model: that the job makes a version of.
    """
    run_id, folder = str(result["run_id"]), data / "jobs" / str(result["run_id"])
    client, registry = MlflowClient(uri), ModelRegistry(uri)
    check_runs(client, run_id, steps, every)
    versions = [one for one in registry.versions(model) if one.run_id == run_id]
    assert [one.number for one in versions] == [result["version"]]
    bundle = Bundle.load(registry.download(versions[0], folder.parent / f"fetched-{run_id}"))
    assert bundle.digest == result["digest"] == versions[0].digest
    models = client.search_logged_models([_experiment(client)], f"source_run_id = '{run_id}'")
    assert [model.status for model in models] == [LoggedModelStatus.READY]
    _check_files(folder)
    weights = {}
    for trial in steps:
        content = read_checkpoint(folder / STAGES[trial] / trial / FINAL)["state_dict"]
        weights[trial] = b"".join(value.numpy().tobytes() for _, value in sorted(content.items()))
    sums = (bundle.folder / "SHA256SUMS").read_text().splitlines()
    digests = {line.split()[1]: line.split()[0] for line in sums if line.endswith(".onnx")}
    return Left(run_id, versions[0].number, weights, digests)


def _experiment(client: MlflowClient) -> str:
    return str(client.get_experiment_by_name(EXPERIMENT).experiment_id)


def check_runs(client: MlflowClient, run_id: str, steps: dict[str, int], every: int) -> None:
    """Whether each trial of a job has one finished run, whose curves have no gap and no step twice."""
    assert client.get_run(run_id).info.status == "FINISHED"
    children = client.search_runs([_experiment(client)], f"tags.mlflow.parentRunId = '{run_id}'")
    names = [_trial(run) for run in children]
    assert sorted(names) == sorted(steps), "every trial has one run"
    assert {run.info.status for run in children} == {"FINISHED"}
    for run in children:
        name = _trial(run)
        wanted = set(range(every, steps[name] + 1, every)) | {1, steps[name]}
        for metric in run.data.metrics:
            points = client.get_metric_history(run.info.run_id, metric)
            counted = Counter(point.step for point in points)
            assert max(counted.values()) == 1, f"{name}: {metric} has a step twice"
            assert wanted <= set(counted), f"{name}: {metric} lacks {wanted - set(counted)}"


def _trial(run: Run) -> str:
    return str(run.data.tags["trial"])


def _check_files(folder: Path) -> None:
    halves = [
        path for path in folder.rglob("*") if path.suffix == ".tmp" or path.name in (".bundle", "last.ckpt")
    ]
    assert halves == []
