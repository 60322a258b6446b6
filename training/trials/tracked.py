"""A module trained by :func:`training.trials.fit.fit`, with its tracking run and Tune's reports."""

import contextlib
import logging
import os

import torch
from ray import tune

from services.registry.mlflow_health import lower_patience
from services.registry.tracking.mlflow_tracking import MlflowTracking
from training.config.clusters import ResourceConfig
from training.models.checkpoint import start_from
from training.models.modules import Metrics, TrialModule
from training.trials.checkpoints import TrialFolder
from training.trials.fit import Rhythm, TrialStopped, fit
from training.trials.outcomes import FINISHED
from training.trials.request import TrialRequest

_LOG = logging.getLogger("training")


def fit_tracked(
    trial: TrialRequest, module: TrialModule, steps: int, resources: ResourceConfig, tracking_uri: str
) -> None:
    """Train a trial's module, from its last checkpoint on where it has one.

    Training goes on while the tracking server is away: metrics wait on disk. A job that is being stopped ends
    it early, with a checkpoint.

    Args:
        trial: which.
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
    # What can not be sent is kept, so there is nothing to be patient for.
    lower_patience(os.environ)
    rhythm = Rhythm(resources.log_every_steps, resources.checkpoint_every_steps)
    label = f"{trial.name} ({trial.job})"
    folder = TrialFolder(trial.folder, resources.checkpoints_kept)
    with contextlib.suppress(TrialStopped), folder.alone():
        if trial.start is not None:
            start_from(trial.start, module)
            _LOG.info("%s: starts from the weights of %s", label, trial.start)
        run = MlflowTracking(tracking_uri, spool_folder=trial.spool).resume(trial.run_id)
        fit(label, module, steps, rhythm, run, folder, _report, trial.stop.exists)


def _report(metrics: Metrics, *, finished: bool) -> None:
    tune.report({**metrics, FINISHED: finished})
