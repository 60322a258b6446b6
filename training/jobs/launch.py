"""Trials on the cluster: one Tuner a stage, with resources and retries; checkpoints tell what is done."""

import logging
import os
import signal
import threading
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

from ray import tune
from ray.tune.experiment import Trial

from cspace.errors import JobError, RegistryError
from cspace.files import holding
from cspace.simulator import derived_seed
from services.evaluator.cluster import join
from services.registry.tracking import RunLog, Tracking
from training.jobs.job import Job
from training.models.checkpoint import read_checkpoint
from training.models.modules import Metrics

_LOG = logging.getLogger("training")
# In a trial's folder: the checkpoint to go on from, which gets the other name when the trial is done.
LAST, FINAL = "last.ckpt", "final.ckpt"
# A worker whose driver was killed may still train for a moment.
BUSY_S = 120.0


@dataclass(frozen=True, slots=True)
class TrialRequest:
    """A trial; it its worker gets it by Tune."""

    folder: Path
    run_id: str = ""
    seed: int = 0
    job: str = ""
    tracking_uri: str = ""
    patience_s: float = 0.0

    @classmethod
    def of(cls, job: Job[Any], stage: str, name: str) -> "TrialRequest":
        """A trial of a job, with the run that it has there and a seed of its own."""
        seed = derived_seed(job.config.seed, stage, name)
        label = f"{job.name or job.run.run_id[:8]}, seed {job.config.seed}"
        uri, patience_s = job.environment.tracking_uri, job.environment.patience_s
        folder = job.folder / stage / name
        return cls(folder, job.child(name), seed, label, uri, patience_s)

    @property
    def name(self) -> str:
        """The trial's name in its stage."""
        return self.folder.name


@dataclass(frozen=True)
class TrialOutcome:
    """What a finished trial leaves."""

    checkpoint: Path

    @property
    def name(self) -> str:
        """The trial's name in its stage."""
        return self.checkpoint.parent.name

    @cached_property
    def history(self) -> list[dict[str, float]]:
        """Its metrics, each row with ``step`` and ``time_ms``."""
        history: list[dict[str, float]] = read_checkpoint(self.checkpoint)["history"]
        return history

    @property
    def metrics(self) -> Metrics:
        """Those of its last step."""
        return {name: value for name, value in self.history[-1].items() if name not in ("step", "time_ms")}

    @property
    def times_s(self) -> tuple[float, float]:
        """Unix times of its first and its last step, by its workers' clocks."""
        return 1e-3 * self.history[0]["time_ms"], 1e-3 * self.history[-1]["time_ms"]

    @property
    def seconds(self) -> float:
        """Between its first and its last step."""
        first, last = self.times_s
        return last - first


# The job's log is for its own progress; what the libraries print of theirs is switched off. An interrupt ends
# a job at once: what it loses lies behind the last checkpoints.
QUIET = {
    "MLFLOW_SUPPRESS_PRINTING_URL_TO_STDOUT": "true",
    "MLFLOW_ENABLE_ARTIFACTS_PROGRESS_BAR": "false",
    "RAY_AIR_NEW_OUTPUT": "0",
    "RAY_CHDIR_TO_TRIAL_DIR": "0",
    "TUNE_DISABLE_AUTO_CALLBACK_LOGGERS": "1",
    "TUNE_DISABLE_SIGINT_HANDLER": "1",
    "TUNE_WARN_EXCESSIVE_EXPERIMENT_CHECKPOINT_SYNC_THRESHOLD_S": "0",
}


def connect() -> None:
    """Join the cluster that ``RAY_ADDRESS`` names (a submitted job has it set), or start a local one.

    SIGTERM then ends the driver as an interrupt does, so that its runs are marked.
    """
    for name, value in QUIET.items():
        os.environ.setdefault(name, value)
    for library in ("mlflow", "ray.tune", "ray.train"):
        logging.getLogger(library).setLevel(logging.ERROR)
    join(runtime_env={"env_vars": QUIET})
    # After ray.init, which sets a handler of its own.
    if threading.current_thread() is threading.main_thread():
        signal.signal(signal.SIGTERM, signal.default_int_handler)


def run_trials(
    job: Job[Any], stage: str, names: Sequence[str], trainable: Callable[..., None], **shared: Any
) -> list[TrialOutcome]:
    """Run the trials of a stage by Ray Tune, as many at once as the cluster has room for.

    ``trainable`` gets the request, the configuration as ``train``, and what is shared, in the object store.

    Trials that an earlier attempt of the job has finished are not run again, and the others go on from their
    own checkpoints. ``Tuner.restore`` is not for this: a driver that was killed may not know the last
    checkpoint, and what lies behind an older one would be counted twice.

    Returns:
        Outcomes in the order of ``names``.
    """
    trials, resources = [TrialRequest.of(job, stage, name) for name in names], job.config.resources
    left = {trial.name: trial for trial in trials if not (trial.folder / FINAL).exists()}
    if len(left) < len(trials):
        _LOG.info("%s: %d of %d trials are finished", stage, len(trials) - len(left), len(trials))
    if left:
        tuner = tune.Tuner(
            tune.with_resources(
                tune.with_parameters(_run_trial, trials=left, run=trainable, train=job.config, **shared),
                resources.of_a_trial(),
            ),
            param_space={"trial": tune.grid_search(list(left))},
            tune_config=tune.TuneConfig(
                trial_name_creator=_name_of, trial_dirname_creator=_name_of, reuse_actors=False
            ),
            run_config=tune.RunConfig(
                name=stage,
                storage_path=str(job.folder / "tune"),
                failure_config=tune.FailureConfig(max_failures=resources.max_failures),
                verbose=0,
            ),
        )
        try:
            grid = tuner.fit()
        except KeyboardInterrupt:
            for trial in left.values():
                with suppress(RegistryError):
                    RunLog(Tracking(trial.tracking_uri), trial.run_id).finish("KILLED")
            raise
        if grid.errors:
            raise JobError(
                f"{len(grid.errors)} of {len(trials)} trials failed",
                expected=f"at most {resources.max_failures} faults each",
                got=str(grid.errors[0]).strip().splitlines()[-1],
                remedy=f"submit the job again: it goes on from the checkpoints under {job.folder / stage}",
            )
    return [TrialOutcome(trial.folder / FINAL) for trial in trials]


def _name_of(trial: Trial) -> str:
    return str(trial.config["trial"])


def _run_trial(
    config: Mapping[str, str],
    trials: Mapping[str, TrialRequest],
    run: Callable[..., None],
    **shared: Any,
) -> None:
    """Run a trial in a worker, alone, unless another attempt has finished it meanwhile."""
    trial = trials[config["trial"]]
    trial.folder.mkdir(parents=True, exist_ok=True)
    busy = JobError(
        f"the trial {trial.name} is run by another process",
        expected=f"its end within {BUSY_S:.0f} s",
        remedy="end that process",
    )
    with holding(trial.folder / "lock", busy, BUSY_S):
        if not (trial.folder / FINAL).exists():
            run(trial, **shared)
            (trial.folder / LAST).rename(trial.folder / FINAL)
