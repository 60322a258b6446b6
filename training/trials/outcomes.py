"""What trials leave in their job's folder: checkpoints, the record of a finished one, unsent metrics."""

import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from ray import tune
from ray.tune.experiment import Trial

from training.models.modules import Metrics
from training.trials.checkpoints import TrialFolder

# In a trial's reports: whether they are of its last step.
FINISHED = "finished"
RECORD = "outcome.json"

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


@dataclass(frozen=True, slots=True)
class TrialPlaces:
    """Where a trial works, on storage that all nodes share.

    Args:
        folder: of its checkpoints and its record.
        spool: of metrics that could not be sent, for all trials of the job.
        stop: a file that is there while the job is being stopped.
    """

    folder: Path
    spool: Path
    stop: Path

    @classmethod
    def of(cls, trial: Mapping[str, Any]) -> "TrialPlaces":
        """Those of a trial's entry, which travels as plain values."""
        return cls(**{name: Path(path) for name, path in trial["places"].items()})

    @classmethod
    def within(cls, storage: Path, name: str) -> "TrialPlaces":
        """Those of a trial whose stage has its storage in the job's folder."""
        return cls(storage / name, spool_folder(storage.parent), stop_file(storage.parent))

    def entry(self) -> dict[str, str]:
        """As plain values."""
        return {name: str(path) for name, path in asdict(self).items()}


def spool_folder(job: Path) -> Path:
    """Where a job's folder keeps metrics that could not be sent."""
    return job / "spool"


def stop_file(job: Path) -> Path:
    """The file by which a job's trials are told to end."""
    return job / "stop"


def read_outcome(folder: Path, name: str) -> TrialOutcome | None:
    """The outcome of a trial that finished in an earlier attempt; None while it has not."""
    checkpoint = TrialFolder(folder).latest()
    try:
        record = json.loads((folder / RECORD).read_text(encoding="utf-8"))
    except FileNotFoundError:
        return None
    return None if checkpoint is None else TrialOutcome(name, checkpoint, **record)


class Outcomes(tune.Callback):
    """Writes the record of every trial in the moment in which it finishes."""

    def __init__(self) -> None:
        self._started_s: dict[str, float] = {}

    def on_trial_result(
        self, iteration: int, trials: list[Trial], trial: Trial, result: dict[str, Any], **info: Any
    ) -> None:
        """Remember when it began; a finished one is recorded here, before anything else can happen."""
        del iteration, trials, info
        name = str(trial.config["trial"]["name"])
        started_s = self._started_s.setdefault(name, result["timestamp"] - result["time_total_s"])
        if not result.get(FINISHED):
            return
        record = {
            "metrics": {key: float(value) for key, value in result.items() if key in OWN_METRICS},
            "started_s": float(started_s),
            "ended_s": float(result["timestamp"]),
        }
        folder = TrialPlaces.of(trial.config["trial"]).folder
        beside = folder / f"{RECORD}.tmp"
        beside.write_text(json.dumps(record), encoding="utf-8")
        beside.replace(folder / RECORD)
