"""Trials on the cluster: Ray Tune with explicit resources, retries, stopping and recorded outcomes."""

import json
import logging
import os
import re
import signal
import threading
from collections.abc import Callable, Mapping, Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass
from pathlib import Path
from types import FrameType, TracebackType
from typing import Any, Self

from ray import tune
from ray.tune.experiment import Trial

from cspace.errors import JobError
from cspace.files import HALF_SUFFIX, discard, holding, write_json
from cspace.simulator import derived_seed
from services.evaluator.cluster import join
from training.config import ResourceConfig
from training.jobs.job import Job
from training.models.checkpoint import Progress, save_checkpoint
from training.models.modules import Metrics, TrialModule

_STEP = re.compile(r"step-(\d{9})")


class TrialFolder:
    """The checkpoints of one trial.

    Args:
        folder: of the trial, on storage that all nodes share; made by the first checkpoint.
        keep: how many of the last ones stay.
    """

    def __init__(self, folder: Path, keep: int = 1) -> None:
        self.folder, self.keep = folder, keep

    def alone(self, patience_s: float = 120.0) -> AbstractContextManager[None]:
        """Hold the trial: a worker whose driver was killed may still train it for a moment.

        Raises:
            JobError: another process holds it, and goes on to.
        """
        self.folder.mkdir(parents=True, exist_ok=True)
        busy = JobError(
            f"the trial {self.folder.name} is run by another process",
            expected=f"its end within {patience_s:.0f} s",
            remedy="end that process",
        )
        return holding(self.folder / "lock", busy, patience_s)

    def checkpoints(self) -> tuple[Path, ...]:
        """Those that are complete, oldest first."""
        found = self.folder.glob("step-*") if self.folder.is_dir() else ()
        return tuple(sorted(path for path in found if _STEP.fullmatch(path.name)))

    def latest(self) -> Path | None:
        """The last one; None before the first."""
        return (self.checkpoints() or (None,))[-1]

    def save(self, module: TrialModule, progress: Progress) -> Path:
        """Write a checkpoint beside, rename it into place, and let the oldest go.

        Raises:
            OSError: the disk is full, or cannot be written.
        """
        saved = save_checkpoint(self.folder / f"step-{progress.step:09d}", module, progress)
        for old in self.checkpoints()[: -self.keep]:
            discard(old)
        # What a process that was killed had not finished; the job may be writing the trial's record.
        for half in self.folder.glob(f"*step-*{HALF_SUFFIX}"):
            discard(half)
        return saved


@dataclass(frozen=True, slots=True)
class TrialRequest:
    """A trial; it travels to its worker through the object store.

    Args:
        folder: of its checkpoints and its record, ``<job>/<stage>/<name>`` on storage that all nodes share.
        run_id: of its tracking run.
        seed: of initialisation and of every draw.
        cluster: whose configurations it learns; None for all.
        start: checkpoint of an earlier job's trial whose weights it starts from; None to start from nothing.
        job: whose it is, for the lines of its log.
    """

    folder: Path
    run_id: str = ""
    seed: int = 0
    cluster: int | None = None
    start: Path | None = None
    job: str = ""

    @classmethod
    def of(cls, job: Job[Any], stage: str, name: str, cluster: int | None = None) -> "TrialRequest":
        """A trial of a job, with the run that it has there and a seed of its own.

        Raises:
            ConfigError: the folder of the job that it is to start from is gone.
        """
        seed = derived_seed(job.config.seed, stage, name)
        earlier = job.start_folder
        start = None if earlier is None else TrialFolder(earlier / stage / name).latest()
        label = f"{job.name or job.run.run_id[:8]}, seed {job.config.seed}"
        return cls(job.folder / stage / name, job.child(name), seed, cluster, start, label)

    @property
    def name(self) -> str:
        """The trial's name in its stage."""
        return self.folder.name

    @property
    def stage(self) -> Path:
        """The folder of the stage's trials."""
        return self.folder.parent

    @property
    def spool(self) -> Path:
        """Where metrics wait that could not be sent, for all trials of the job."""
        return self.stage.parent / "spool"

    @property
    def stop(self) -> Path:
        """A file that is there while the job is being stopped."""
        return stop_file(self.stage.parent)


def stop_file(job: Path) -> Path:
    """The file by which a job's trials are told to end."""
    return job / "stop"


# In a trial's reports: its own metrics, to which Tune adds others, and whether they are of its last step.
METRICS, FINISHED = "metrics", "finished"
RECORD = "outcome.json"


@dataclass(frozen=True, slots=True)
class TrialOutcome:
    """What a finished trial leaves.

    Args:
        name: the trial's name.
        checkpoint: folder with its weights.
        metrics: its last metrics.
        started_s: Unix time of its start by Tune's own clock; of its last attempt's, where there were more.
        ended_s: Unix time of its last report by Tune's own clock.
    """

    name: str
    checkpoint: Path
    metrics: Metrics
    started_s: float
    ended_s: float


def read_outcome(trial: TrialRequest) -> TrialOutcome | None:
    """The outcome of a trial that finished in an earlier attempt; None while it has not."""
    checkpoint = TrialFolder(trial.folder).latest()
    try:
        record = json.loads((trial.folder / RECORD).read_text(encoding="utf-8"))
    except FileNotFoundError:
        return None
    return None if checkpoint is None else TrialOutcome(trial.name, checkpoint, **record)


class Outcomes(tune.Callback):
    """Writes the record of every trial in the moment in which it finishes.

    Args:
        stage: the folder of the trials.
    """

    def __init__(self, stage: Path) -> None:
        self._stage = stage
        self._started_s: dict[str, float] = {}

    def on_trial_result(
        self, iteration: int, trials: list[Trial], trial: Trial, result: dict[str, Any], **info: Any
    ) -> None:
        """Remember when it began; a finished one is recorded here, before anything else can happen."""
        del iteration, trials, info
        name = str(trial.config["trial"])
        started_s = self._started_s.setdefault(name, result["timestamp"] - result["time_total_s"])
        if not result.get(FINISHED):
            return
        record = {
            "metrics": {key: float(value) for key, value in result[METRICS].items() if key != "step"},
            "started_s": float(started_s),
            "ended_s": float(result["timestamp"]),
        }
        write_json(self._stage / name / RECORD, record)


_LOG = logging.getLogger("training")


def end_on_request() -> None:
    """Let SIGTERM end the driver as an interrupt does, so that its runs are marked.

    To be called after ``ray.init``, which sets a handler of its own.
    """
    if threading.current_thread() is threading.main_thread():
        signal.signal(signal.SIGTERM, signal.default_int_handler)


class Stop(tune.Callback):
    """While it is entered, SIGTERM tells the trials to write a checkpoint and end, and then ends Tune's loop.

    Args:
        file: by which the trials are told. Whoever is not the driver may make it as well, between two stages
            too; the job deletes it when it is run again.
    """

    def __init__(self, file: Path) -> None:
        self._file = file
        self._before: Any = None
        self._main = threading.current_thread() is threading.main_thread()

    def __enter__(self) -> Self:
        if self._main:
            self._before = signal.signal(signal.SIGTERM, self._request)
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._main:
            signal.signal(signal.SIGTERM, self._before)

    def on_step_end(self, iteration: int, trials: list[Trial], **info: Any) -> None:
        """End the loop once no trial runs; those that wait for their turn wait for the next attempt."""
        del iteration, info
        if self._file.exists() and not any(trial.status == Trial.RUNNING for trial in trials):
            # The signal by which Tune's loop is ended from outside.
            os.kill(os.getpid(), signal.SIGUSR1)

    def _request(self, number: int, frame: FrameType | None) -> None:
        del number, frame
        _LOG.info("stopping: the trials write their checkpoints")
        self._file.touch()


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
    join(runtime_env={"env_vars": QUIET})
    end_on_request()


def run_trials(
    trainable: Callable[..., None],
    trials: Sequence[TrialRequest],
    shared: Mapping[str, Any],
    resources: ResourceConfig,
) -> list[TrialOutcome]:
    """Run the trials of a stage, as many at once as the cluster has room for.

    Where their folders are those of a job that was stopped, finished ones are not run again, and the others
    go on from their checkpoints.

    Args:
        trainable: gets a trial and ``shared`` by keyword, in Tune's worker.
        trials: of one stage.
        shared: arrays and settings, put into the object store once.
        resources: of each trial.

    Returns:
        Outcomes in the order of ``trials``.

    Raises:
        JobError: a trial failed more often than it may.
        KeyboardInterrupt: the job was asked to stop; its trials have written their checkpoints.
    """
    left = [trial for trial in trials if read_outcome(trial) is None]
    if len(left) < len(trials):
        finished = len(trials) - len(left)
        _LOG.info("%s: %d of %d trials are finished", trials[0].stage.name, finished, len(trials))
    if left:
        _fit(trainable, left, shared, resources)
    outcomes = [read_outcome(trial) for trial in trials]
    return [outcome for outcome in outcomes if outcome is not None]


def _fit(
    trainable: Callable[..., None],
    trials: Sequence[TrialRequest],
    shared: Mapping[str, Any],
    resources: ResourceConfig,
) -> None:
    storage, requests = trials[0].stage, {trial.name: trial for trial in trials}
    bound = bind(trainable, requests, shared, resources)
    stop = Stop(trials[0].stop)
    tuner = tune.Tuner(
        bound,
        param_space={"trial": tune.grid_search(list(requests))},
        tune_config=tune.TuneConfig(
            reuse_actors=True,
            trial_name_creator=_trial_name,
            trial_dirname_creator=_trial_name,
        ),
        run_config=tune.RunConfig(
            name=_attempt(storage),
            storage_path=str(storage),
            failure_config=tune.FailureConfig(max_failures=resources.max_failures),
            callbacks=[Outcomes(storage), stop],
            verbose=0,
        ),
    )
    with stop:
        grid = tuner.fit()
    failed = [str(error) for error in grid.errors]
    if failed:
        raise JobError(
            f"{len(failed)} of {len(trials)} trials failed",
            expected=f"at most {resources.max_failures} faults each",
            got=failed[0].strip().splitlines()[-1],
            remedy=f"their logs are under {storage}; submitted again the job goes on from its checkpoints",
        )
    if any(read_outcome(trial) is None for trial in trials):
        raise KeyboardInterrupt


def bind(
    trainable: Callable[..., None],
    requests: Mapping[str, TrialRequest],
    shared: Mapping[str, Any],
    resources: ResourceConfig,
) -> Callable[..., None]:
    """A Tune function of a stage's trials that Tune knows by a name which no other job's has.

    Tune finds a function by its name alone among all that one driver has registered: of two jobs in one
    driver, one would otherwise be handed the trials of the other.
    """
    bound: Callable[..., None] = tune.with_resources(
        tune.with_parameters(_asked(trainable), requests=requests, **shared),
        resources.of_a_trial(),
    )
    stage = next(iter(requests.values())).stage
    # Read by Tune before __name__, which stays what logs show.
    vars(bound)["_name"] = f"{trainable.__name__}-{stage.parent.name}-{stage.name}"
    return bound


def _asked(trainable: Callable[..., None]) -> Callable[..., None]:
    """A Tune function: Tune keeps what it is configured with on disk, so it gets the trial's name alone."""

    def run(config: Mapping[str, str], requests: Mapping[str, TrialRequest], **shared: Any) -> None:
        trainable(requests[config["trial"]], **shared)

    # Ray shows it in its logs.
    run.__name__ = trainable.__name__
    return run


def _attempt(storage: Path) -> str:
    """A name for Tune's own files: each attempt has a folder, and none depends on an earlier one."""
    return f"tune-{1 + sum(1 for _ in storage.glob('tune-*')):03d}"


def _trial_name(trial: Trial) -> str:
    return str(trial.config["trial"])
