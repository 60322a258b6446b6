"""A module trained by :func:`training.trials.fit.fit`, with its tracking run and Tune's reports."""

import contextlib
import logging
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import torch
from ray import tune

from services.registry.mlflow_tracking import MlflowTracking
from training.config import ResourceConfig
from training.models.modules import Metrics, TrialModule
from training.trials.fit import Rhythm, fit


def fit_tracked(
    trial: Mapping[str, Any], module: TrialModule, steps: int, resources: ResourceConfig, tracking_uri: str
) -> None:
    """Train a trial's module, from its checkpoint on where it has one.

    Args:
        trial: its ``name`` and ``run_id``.
        module: to be trained.
        steps: in all.
        resources: how often it logs and checkpoints.
        tracking_uri: of the tracking server.
    """
    # One thread a process: two torch pools on two cores are slower than one thread each.
    torch.set_num_threads(1)
    logging.basicConfig(level=logging.WARNING, format="%(message)s", force=True)
    logging.getLogger("training").setLevel(logging.INFO)
    for library in ("lightning.pytorch", "ray.train", "ray.tune"):
        logging.getLogger(library).setLevel(logging.ERROR)
    rhythm = Rhythm(resources.log_every_steps, resources.checkpoint_every_steps)
    run = MlflowTracking(tracking_uri).resume(trial["run_id"])
    with _checkpoint() as folder:
        fit(trial["name"], module, steps, rhythm, run, _report, folder)


def _report(metrics: Metrics, folder: Path | None) -> None:
    checkpoint = None if folder is None else tune.Checkpoint.from_directory(str(folder))
    tune.report(metrics, checkpoint=checkpoint)


@contextlib.contextmanager
def _checkpoint() -> Iterator[Path | None]:
    checkpoint = tune.get_checkpoint()
    if checkpoint is None:
        yield None
        return
    with checkpoint.as_directory() as folder:
        yield Path(folder)
