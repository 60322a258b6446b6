"""What a stack must not lose: runs with their metrics, versions with their aliases and bundles, data."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import mlflow

from cspace.bundle import Bundle
from services.names import MODEL_NAME
from services.registry.entities import ModelVersion
from services.registry.models import ModelRegistry
from tests.compose.stack import Stack

LIST_DATA = "cd /var/lib/cspace/datasets && find . -type f -exec sha256sum {} + | sort"


@dataclass(frozen=True)
class Kept:
    """What MLflow knows: runs by their id with state, name, last metrics and artifacts; all versions."""

    runs: Mapping[str, tuple[str, str | None, Mapping[str, float], tuple[str, ...]]]
    versions: tuple[ModelVersion, ...]

    @classmethod
    def by(cls, stack: Stack) -> "Kept":
        client = mlflow.MlflowClient(stack.url("MLFLOW"))
        experiments = [found.experiment_id for found in client.search_experiments()]
        runs = {
            run.info.run_id: (
                run.info.status,
                run.info.run_name,
                dict(run.data.metrics),
                tuple(sorted(found.path for found in client.list_artifacts(run.info.run_id))),
            )
            for run in client.search_runs(experiments)
        }
        return cls(runs, ModelRegistry(stack.url("MLFLOW")).versions(MODEL_NAME))


def downloaded_digest(stack: Stack, alias: str, folder: Path) -> str:
    """The digest of the bundle behind an alias, downloaded, its sums and golden case passed."""
    registry = ModelRegistry(stack.url("MLFLOW"))
    version = registry.by_alias(MODEL_NAME, alias)
    digest = Bundle.load(registry.download(version, folder / "bundle")).digest
    assert digest == version.digest
    return digest


def data_files(stack: Stack) -> list[str]:
    """Sum and name of every file of the data sets in the data volume."""
    return stack.compose("exec", "-T", "ray-head", "sh", "-c", LIST_DATA).splitlines()
