"""One trial's training: Lightning, with its checkpoints, buffered tracking and progress lines."""

import logging
import os
import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import lightning
import torch
from lightning.pytorch.callbacks import ModelCheckpoint

from cspace.errors import RegistryError, RegistryUnavailableError
from services.commands import Estimate
from services.registry.errors import retry, set_timeouts
from services.registry.tracking import RunLog, Tracking
from training.config import ResourceConfig, TrialSettings
from training.jobs.launch import LAST, TrialRequest
from training.models.checkpoint import fit_module
from training.models.modules import TrialModule

# Readers of a log want a line now and then, however fast the steps are.
LINE_EVERY_S = 5.0
# A server that hangs costs the client's timeout at each try.
RETRY_S = 10.0

_LOG = logging.getLogger("training")


class TrialCheckpoint(ModelCheckpoint):
    """Keeps the last checkpoint of a trial, with its metrics up to there, and sends these afterwards.

    So a trial that goes on from it sends the same points again, which the server drops, and no others.
    """

    def __init__(
        self,
        label: str,
        steps: int,
        resources: ResourceConfig,
        run: RunLog,
        folder: Path,
        parameters: Mapping[str, Any] | None = None,
    ) -> None:
        super().__init__(
            folder,
            LAST.removesuffix(".ckpt"),
            every_n_train_steps=resources.checkpoint_every_steps,
            enable_version_counter=False,
        )
        self.label, self.steps, self.resources, self.run = label, steps, resources, run
        self.parameters = parameters or {}
        self.history: list[dict[str, float]] = []
        self.sent, self.away_until_s, self.shown_s = 0, float("-inf"), float("-inf")
        self.first, self.started_s, self.estimate = 0, 0.0, Estimate(steps)

    def on_save_checkpoint(
        self, trainer: lightning.Trainer, pl_module: lightning.LightningModule, checkpoint: dict[str, Any]
    ) -> None:
        """Keep the metrics."""
        del trainer, pl_module
        checkpoint["history"] = self.history

    def on_load_checkpoint(
        self, trainer: lightning.Trainer, pl_module: lightning.LightningModule, checkpoint: dict[str, Any]
    ) -> None:
        """Go on with the metrics."""
        del trainer, pl_module
        self.history = list(checkpoint["history"])

    def on_train_start(self, trainer: lightning.Trainer, pl_module: lightning.LightningModule) -> None:
        """Start the clocks."""
        super().on_train_start(trainer, pl_module)
        self.first, self.started_s = trainer.global_step, time.monotonic()
        self.estimate = Estimate(self.steps, self.first)
        self._try_to_send()

    def on_train_batch_end(
        self, trainer: lightning.Trainer, pl_module: lightning.LightningModule, *others: Any
    ) -> None:
        """Log, checkpoint and send, or neither."""
        step = trainer.global_step
        if isinstance(pl_module, TrialModule) and (
            step in (1, self.steps) or step % self.resources.log_every_steps == 0
        ):
            self._log(pl_module, step)
        super().on_train_batch_end(trainer, pl_module, *others)
        if step % self.resources.checkpoint_every_steps == 0 and time.monotonic() > self.away_until_s:
            self._try_to_send()

    def on_train_end(self, trainer: lightning.Trainer, pl_module: lightning.LightningModule) -> None:
        """Keep the last step."""
        del pl_module
        trainer.save_checkpoint(Path(str(self.dirpath), LAST))

    def send(self) -> None:
        """Send what the run does not have."""
        try:
            self.run.params(self.parameters)
            self.parameters = {}
        except RegistryUnavailableError:
            raise
        except RegistryError as error:
            # A trial may go on where another version of the code, or another device, began it.
            _LOG.warning("%s: other parameters than it began with: %s", self.label, error)
        self.run.history(self.history[self.sent :])
        self.sent = len(self.history)

    def _try_to_send(self) -> None:
        try:
            self.send()
        except RegistryUnavailableError as error:
            _LOG.warning("%s: metrics are sent later: %s", self.label, error)
            self.away_until_s = time.monotonic() + RETRY_S

    def _log(self, module: TrialModule, step: int) -> None:
        elapsed_s = time.monotonic() - self.started_s
        metrics = module.metrics() | {"steps_per_s": (step - self.first) / max(elapsed_s, 1e-9)}
        self.history.append({"step": float(step), "time_ms": float(time.time_ns() // 1_000_000), **metrics})
        if elapsed_s - self.shown_s < LINE_EVERY_S and step < self.steps:
            return
        self.shown_s = elapsed_s
        shown = ", ".join(f"{key} {value:.4g}" for key, value in metrics.items() if key != "steps_per_s")
        _LOG.info("%s: step %d/%d, %s%s", self.label, step, self.steps, shown, self.estimate.left(step))


def fit(
    label: str,
    module: TrialModule,
    steps: int,
    resources: ResourceConfig,
    run: RunLog,
    folder: Path,
    parameters: Mapping[str, Any] | None = None,
    patience_s: float = 0.0,
) -> None:
    """Train ``module`` up to ``steps``, from the last checkpoint when there is one, and end its run.

    Training goes on while the tracking server is away; it has to be back within ``patience_s`` at the end.
    """
    callback = TrialCheckpoint(label, steps, resources, run, folder, parameters)
    with run:
        fit_module(module, steps, folder / LAST, [callback])
        retry(f"{label}: sending the last metrics", callback.send, patience_s)


def fit_tracked(
    trial: TrialRequest,
    module: TrialModule,
    settings: TrialSettings,
    resources: ResourceConfig,
    **extra_parameters: Any,
) -> None:
    """Train a trial's module, from its last checkpoint on where it has one, in the trial's run."""
    # No more threads than the trial claims: two pools on the same cores are slower than one thread each.
    torch.set_num_threads(resources.threads)
    logging.basicConfig(level=logging.WARNING, format="%(message)s", force=True)
    logging.getLogger("training").setLevel(logging.INFO)
    logging.getLogger("lightning.pytorch").setLevel(logging.ERROR)
    # What can not be sent is sent later.
    set_timeouts(os.environ)
    label = f"{trial.name} ({trial.job})"
    run = RunLog(Tracking(trial.tracking_uri), trial.run_id)
    parameters = _parameters(trial, module, settings) | extra_parameters
    fit(label, module, settings.steps, resources, run, trial.folder, parameters, trial.patience_s)


def _parameters(trial: TrialRequest, module: TrialModule, settings: TrialSettings) -> dict[str, Any]:
    """What trials are compared by; settings keep their names."""
    device = "cuda" if torch.cuda.is_available() else "cpu"
    sizes = {"parameters": sum(one.numel() for one in module.parameters())}
    return settings.to_dict() | sizes | {"seed": trial.seed, "device": device}
