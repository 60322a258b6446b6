"""Trials on the cluster: a Ray task each, with resources, retries, a way to stop, and outcomes."""

import json
import logging
import os
import re
import signal
import threading
import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from types import FrameType
from typing import Any

import ray
from ray.exceptions import RayError

from cspace.errors import JobError
from cspace.files import HALF_SUFFIX, discard, holding, write_json
from cspace.simulator import derived_seed
from services.evaluator.cluster import cancel, join
from training.config import ResourceConfig
from training.jobs.job import Job
from training.models.checkpoint import Progress, save_checkpoint
from training.models.modules import Metrics, TrialModule

_STEP = re.compile(r"step-(\d{9})")


class TrialFolder:
    """The checkpoints of one trial."""

    def __init__(self, folder: Path, keep: int = 1) -> None:
        self.folder, self.keep = folder, keep

    def alone(self, patience_s: float = 120.0) -> AbstractContextManager[None]:
        """Hold the trial: a worker whose driver was killed may still train it for a moment."""
        self.folder.mkdir(parents=True, exist_ok=True)
        busy = JobError(
            f"the trial {self.folder.name} is run by another process",
            expected=f"its end within {patience_s:.0f} s",
            remedy="end that process",
        )
        return holding(self.folder / "lock", busy, patience_s)

    def is_run(self) -> bool:
        """Whether a process runs the trial now."""
        try:
            with self.alone(patience_s=0.0):
                return False
        except JobError:
            return True

    def checkpoints(self) -> tuple[Path, ...]:
        """Those that are complete, oldest first."""
        found = self.folder.glob("step-*") if self.folder.is_dir() else ()
        return tuple(sorted(path for path in found if _STEP.fullmatch(path.name)))

    def latest(self) -> Path | None:
        """The last one; None before the first."""
        return (self.checkpoints() or (None,))[-1]

    def save(self, module: TrialModule, progress: Progress) -> Path:
        """Write a checkpoint beside, rename it into place, and let the oldest go."""
        saved = save_checkpoint(self.folder / f"step-{progress.step:09d}", module, progress)
        for old in self.checkpoints()[: -self.keep]:
            discard(old)
        # What a process that was killed had not finished; the job may be writing the trial's record.
        for half in self.folder.glob(f"*step-*{HALF_SUFFIX}"):
            discard(half)
        return saved


@dataclass(frozen=True, slots=True)
class TrialRequest:
    """A trial; it travels to its worker through the object store."""

    folder: Path
    run_id: str = ""
    seed: int = 0
    cluster: int | None = None
    start: Path | None = None
    job: str = ""

    @classmethod
    def of(cls, job: Job[Any], stage: str, name: str, cluster: int | None = None) -> "TrialRequest":
        """A trial of a job, with the run that it has there and a seed of its own."""
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
    def stop(self) -> Path:
        """A file that is there while the job is being stopped."""
        return stop_file(self.stage.parent)


def stop_file(job: Path) -> Path:
    """The file by which a job's trials are told to end."""
    return job / "stop"


RECORD = "outcome.json"
# Between two looks of a driver at its trials and at the request to stop them.
LOOK_EVERY_S = 0.5


@dataclass(frozen=True, slots=True)
class TrialOutcome:
    """What a finished trial leaves.

    Args:
        started_s: Unix time of its start by its worker's clock; of its last attempt's, where there were
            more.
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


_LOG = logging.getLogger("training")


def end_on_request() -> None:
    """Let SIGTERM end the driver as an interrupt does, so that its runs are marked.

    To be called after ``ray.init``, which sets a handler of its own.
    """
    if threading.current_thread() is threading.main_thread():
        signal.signal(signal.SIGTERM, signal.default_int_handler)


@contextmanager
def stop_on_sigterm(file: Path) -> Iterator[None]:
    """While the block runs, SIGTERM makes the file that tells trials to write a checkpoint and end.

    Whoever is not the driver may make the file as well, between two stages too; the job deletes it when it is
    run again.
    """
    if threading.current_thread() is not threading.main_thread():
        yield
        return

    def request(number: int, frame: FrameType | None) -> None:
        del number, frame
        _LOG.info("stopping: the trials write their checkpoints")
        file.touch()

    before = signal.signal(signal.SIGTERM, request)
    try:
        yield
    finally:
        signal.signal(signal.SIGTERM, before)


# The job's log is for its own progress; what the libraries print of theirs is switched off.
QUIET = {
    "MLFLOW_SUPPRESS_PRINTING_URL_TO_STDOUT": "true",
    "MLFLOW_ENABLE_ARTIFACTS_PROGRESS_BAR": "false",
}


def connect() -> None:
    """Join the cluster that ``RAY_ADDRESS`` names (a submitted job has it set), or start a local one."""
    for name, value in QUIET.items():
        os.environ.setdefault(name, value)
    logging.getLogger("mlflow").setLevel(logging.ERROR)
    join(runtime_env={"env_vars": QUIET})
    end_on_request()


def run_trials(
    trainable: Callable[..., Metrics | None],
    trials: Sequence[TrialRequest],
    shared: Mapping[str, Any],
    resources: ResourceConfig,
) -> list[TrialOutcome]:
    """Run the trials of a stage, as many at once as the cluster has room for.

    Where their folders are those of a job that was stopped, finished ones are not run again, and the others
    go on from their checkpoints.

    Returns:
        Outcomes in the order of ``trials``.
    """
    left = [trial for trial in trials if read_outcome(trial) is None]
    if len(left) < len(trials):
        finished = len(trials) - len(left)
        _LOG.info("%s: %d of %d trials are finished", trials[0].stage.name, finished, len(trials))
    if left:
        _run_all(trainable, left, shared, resources)
    outcomes = [read_outcome(trial) for trial in trials]
    if any(outcome is None for outcome in outcomes):
        raise KeyboardInterrupt
    return [outcome for outcome in outcomes if outcome is not None]


def _run_all(
    trainable: Callable[..., Metrics | None],
    trials: Sequence[TrialRequest],
    shared: Mapping[str, Any],
    resources: ResourceConfig,
) -> None:
    """Run trials until each has ended or, where the job is being stopped, until none runs any more."""
    stage, stop = trials[0].stage, trials[0].stop
    # A worker ends with its trial, and what torch has allocated with it.
    task = ray.remote(max_calls=1)(_run_trial)
    stored = {name: ray.put(value) for name, value in shared.items()}
    waiting: dict[ray.ObjectRef[Any], TrialRequest] = {}
    failed: list[str] = []
    try:
        with stop_on_sigterm(stop):
            for trial in trials:
                placed = task.options(
                    name=f"{stage.name}/{trial.name}",
                    max_retries=resources.max_failures,
                    retry_exceptions=True,
                    **resources.of_a_task(),
                )
                waiting[placed.remote(trainable, trial, **stored)] = trial
            while waiting:
                stopped = _stopped(stop, waiting.values())
                ended, _ = ray.wait(list(waiting), num_returns=1, timeout=LOOK_EVERY_S)
                for reference in ended:
                    failed += _failure(reference)
                    _log_end(waiting.pop(reference), len(trials) - len(waiting), len(trials))
                if stopped and not ended:
                    break
    finally:
        with suppress(RayError, ConnectionError):
            cancel(list(waiting))
    if failed:
        raise JobError(
            f"{len(failed)} of {len(trials)} trials failed",
            expected=f"at most {resources.max_failures} faults each",
            got=failed[0].strip().splitlines()[-1],
            remedy=f"their checkpoints are under {stage}; submitted again the job goes on from them",
        )


def _stopped(stop: Path, trials: Iterable[TrialRequest]) -> bool:
    """Whether the job is being stopped and none of its trials runs; one that starts later ends at once."""
    return stop.exists() and not any(TrialFolder(trial.folder).is_run() for trial in trials)


def _failure(reference: "ray.ObjectRef[Any]") -> list[str]:
    """Why a task failed for good, in one text; nothing where it did not."""
    try:
        ray.get(reference)
    except RayError as error:
        return [str(error)]
    return []


def _log_end(trial: TrialRequest, ended: int, count: int) -> None:
    state = "stopped" if trial.stop.exists() else "failed"
    state = state if read_outcome(trial) is None else "finished"
    _LOG.info("%s (%s): %s; %d of %d trials have ended", trial.name, trial.job, state, ended, count)


def _run_trial(trainable: Callable[..., Metrics | None], trial: TrialRequest, **shared: Any) -> None:
    """Run a trial in a worker, alone, and record its outcome; do nothing where it has one or is to stop.

    A driver that is gone cannot lose an outcome, for the worker writes it.
    """
    with TrialFolder(trial.folder).alone():
        if trial.stop.exists() or read_outcome(trial) is not None:
            return
        started_s = time.time()
        try:
            metrics = trainable(trial, **shared)
        except Exception as error:
            # Ray tells only of the last attempt's.
            _LOG.warning(
                "%s (%s): an attempt failed: %s: %s", trial.name, trial.job, type(error).__name__, error
            )
            raise
        if metrics is not None:
            numbers = {name: float(value) for name, value in metrics.items()}
            record = {"metrics": numbers, "started_s": started_s, "ended_s": time.time()}
            write_json(trial.folder / RECORD, record)
