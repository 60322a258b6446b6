"""A module trained by :func:`training.trials.fit.fit`, with its tracking run and Tune's reports."""

import contextlib
import logging
import os
from collections.abc import Mapping
from typing import Any, Protocol

import torch
from ray import tune

from cspace.errors import RegistryError, RegistryUnavailableError
from services.registry.mlflow_health import lower_patience
from services.registry.tracking.mlflow_tracking import MlflowTracking
from services.registry.tracking.port import RunLog
from training.config.clusters import ResourceConfig
from training.models.checkpoint import start_from
from training.models.modules import Metrics, TrialModule
from training.trials.checkpoints import TrialFolder
from training.trials.fit import Rhythm, TrialStopped, fit
from training.trials.outcomes import FINISHED, METRICS
from training.trials.request import TrialRequest

_LOG = logging.getLogger("training")


class TrialSettings(Protocol):
    """The section of a job's configuration that a trial is trained by."""

    @property
    def steps(self) -> int:
        """Of training, in all."""
        ...

    def to_dict(self) -> dict[str, Any]:
        """Plain values by key."""
        ...


def fit_tracked(
    trial: TrialRequest,
    module: TrialModule,
    settings: TrialSettings,
    resources: ResourceConfig,
    tracking_uri: str,
    **told: Any,
) -> None:
    """Train a trial's module, from its last checkpoint on where it has one.

    Training goes on while the tracking server is away: metrics wait on disk. A job that is being stopped ends
    it early, with a checkpoint.

    Args:
        trial: which.
        module: to be trained.
        settings: by which it is trained.
        resources: how often it logs and checkpoints.
        tracking_uri: of the tracking server.
        told: further parameters of its run, such as its share of the data.
    """
    # No more threads than the trial claims: two pools on the same cores are slower than one thread each.
    torch.set_num_threads(resources.threads)
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
        parameters = _parameters(trial, module, settings) | told
        shown = _show(run, parameters)
        fit(label, module, settings.steps, rhythm, run, folder, _report, trial.stop.exists)
        if not shown:
            _show(run, parameters)


def _parameters(trial: TrialRequest, module: TrialModule, settings: TrialSettings) -> dict[str, Any]:
    """What trials are compared by; settings keep their names."""
    cluster = {} if trial.cluster is None else {"cluster": trial.cluster}
    device = "cuda" if torch.cuda.is_available() else "cpu"
    sizes = {"parameters": sum(one.numel() for one in module.parameters())}
    return settings.to_dict() | cluster | sizes | {"seed": trial.seed, "device": device}


def _show(run: RunLog, parameters: Mapping[str, Any]) -> bool:
    """Whether the run has them; a trial does not wait for that, and may go on where another began it."""
    try:
        run.params(parameters)
    except RegistryUnavailableError:
        return False
    except RegistryError as error:
        _LOG.warning("run %s: other parameters than it began with: %s", run.run_id, error)
    return True


def _report(metrics: Metrics, *, finished: bool) -> None:
    tune.report({METRICS: metrics, FINISHED: finished})
