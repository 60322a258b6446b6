"""What trials leave in their job's folder: checkpoints, the record of a finished one, unsent metrics."""

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from ray import tune
from ray.tune.experiment import Trial

from cspace.files import write_json
from training.models.modules import Metrics
from training.trials.checkpoints import TrialFolder
from training.trials.request import TrialRequest

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
