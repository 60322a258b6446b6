"""Running trials on the cluster: Ray Tune with explicit resources, retries and checkpoints."""

import logging
import os
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import ray
from ray import tune

from cspace.errors import JobError
from training.config import ResourceConfig
from training.models.modules import Metrics

_LOG = logging.getLogger("training")


@dataclass(frozen=True, slots=True)
class TrialOutcome:
    """What a finished trial leaves.

    Args:
        name: the trial's name.
        checkpoint: folder with its weights.
        metrics: its last metrics.
        started_s: Unix time of its start by Tune's own clock.
        ended_s: Unix time of its last report by Tune's own clock.
    """

    name: str
    checkpoint: Path
    metrics: Metrics
    started_s: float
    ended_s: float


# What trials report of themselves; Tune adds more.
OWN_METRICS = frozenset(
    {
        "vae_loss",
        "reconstruction_loss",
        "kl",
        "validity_loss",
        "validity_accuracy",
        "critic_loss",
        "wasserstein_estimate",
        "gradient_penalty",
        "generator_loss",
        "gate_loss",
        "gate_divergence",
        "distillation_loss",
        "density_loss",
        "progress_loss",
        "offset_loss",
        "flow_loss",
        "path_error",
        "steps_per_s",
    }
)

# The job's log is for its own progress; what the libraries print of theirs is switched off.
QUIET = {
    "RAY_AIR_NEW_OUTPUT": "0",
    "TUNE_WARN_EXCESSIVE_EXPERIMENT_CHECKPOINT_SYNC_THRESHOLD_S": "0",
    "MLFLOW_SUPPRESS_PRINTING_URL_TO_STDOUT": "true",
    "MLFLOW_ENABLE_ARTIFACTS_PROGRESS_BAR": "false",
}


def connect() -> None:
    """Join the cluster that ``RAY_ADDRESS`` names (a submitted job has it set), or start a local one."""
    for name, value in QUIET.items():
        os.environ.setdefault(name, value)
    for library in ("ray.tune", "ray.train", "mlflow"):
        logging.getLogger(library).setLevel(logging.ERROR)
    if not ray.is_initialized():
        ray.init(logging_level=logging.WARNING, include_dashboard=False, runtime_env={"env_vars": QUIET})


def run_trials(
    trainable: Callable[..., None],
    trials: Sequence[Mapping[str, Any]],
    shared: Mapping[str, Any],
    resources: ResourceConfig,
    storage: Path,
) -> list[TrialOutcome]:
    """Run one trial for each entry, as many at once as the cluster has room for.

    Where ``storage`` holds the trials of a job that was stopped, they go on from their checkpoints.

    Args:
        trainable: a Tune function trainable; gets ``{"trial": entry}`` and ``shared`` by keyword.
        trials: small plain values a trial, each with a ``name``.
        shared: arrays and settings, put into the object store once.
        resources: of each trial.
        storage: folder for Tune's own files.

    Returns:
        Outcomes in the order of ``trials``.

    Raises:
        JobError: a trial failed more often than it may.
    """
    bound = tune.with_resources(
        tune.with_parameters(trainable, **shared),
        resources.of_a_trial(),
    )
    if tune.Tuner.can_restore(str(storage)):
        _LOG.info("%s: going on", storage.name)
        tuner = tune.Tuner.restore(str(storage), trainable=bound, resume_errored=True)
    else:
        tuner = tune.Tuner(
            bound,
            param_space={"trial": tune.grid_search(list(trials))},
            tune_config=tune.TuneConfig(reuse_actors=True),
            run_config=_run_config(resources, storage),
        )
    grid = tuner.fit()
    failed = [str(error) for error in grid.errors]
    if failed:
        raise JobError(
            f"{len(failed)} of {len(trials)} trials failed",
            expected=f"at most {resources.max_failures} faults each",
            got=failed[0].strip().splitlines()[-1],
            remedy=f"the trials' logs are under {storage}",
        )
    outcomes = {outcome.name: outcome for outcome in (_outcome(grid[index]) for index in range(len(grid)))}
    return [outcomes[str(trial["name"])] for trial in trials]


def _run_config(resources: ResourceConfig, storage: Path) -> tune.RunConfig:
    return tune.RunConfig(
        name=storage.name,
        storage_path=str(storage.parent),
        failure_config=tune.FailureConfig(max_failures=resources.max_failures),
        checkpoint_config=tune.CheckpointConfig(num_to_keep=resources.checkpoints_kept),
        verbose=0,
    )


def _outcome(result: Any) -> TrialOutcome:
    rows = result.metrics_dataframe
    first, last = rows.iloc[0], rows.iloc[-1]
    metrics = {key: float(value) for key, value in result.metrics.items() if key in OWN_METRICS}
    return TrialOutcome(
        name=str(result.config["trial"]["name"]),
        checkpoint=Path(result.checkpoint.path),
        metrics=metrics,
        started_s=float(first["timestamp"] - first["time_total_s"]),
        ended_s=float(last["timestamp"]),
    )
