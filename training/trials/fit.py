"""One trial's training loop: Lightning, with buffered tracking, progress lines and checkpoints."""

import logging
import os
import time
import warnings
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import lightning
import torch
from torch.utils.data import DataLoader

from cspace.errors import RegistryError, RegistryUnavailableError
from cspace.files import write_json
from services.progress import Estimate
from services.registry.errors import set_timeouts
from services.registry.tracking import RunLog, Tracking
from training.config import ResourceConfig, TrialSettings
from training.jobs.job import MISSED
from training.models.checkpoint import Progress, load_checkpoint, read_progress, start_from
from training.models.data import StepCounter
from training.models.modules import Metrics, TrialModule
from training.trials.launch import TrialFolder, TrialRequest

# Readers of a log want a line now and then, however fast the steps are.
LINE_EVERY_S = 5.0
# A server that hangs costs the client's timeout at each try.
RETRY_S = 10.0
# Whoever stops a job waits for this and for a checkpoint.
STOP_LOOK_EVERY_S = 0.25

_LOG = logging.getLogger("training")


class TrialStopped(BaseException):
    """The trial was asked to stop, and has written a checkpoint."""


class TrialCallback(lightning.Callback):
    """Logs a trial's metrics and keeps its checkpoints."""

    def __init__(
        self,
        name: str,
        progress: Progress,
        steps: int,
        resources: ResourceConfig,
        run: RunLog,
        folder: TrialFolder,
        stopping: Callable[[], bool],
    ) -> None:
        self.name, self.step, self.steps = name, progress.step, steps
        self.resources, self.run, self.folder = resources, run, folder
        self.stopping, self.stopped, self.looked_s = stopping, False, time.monotonic()
        self.history = [dict(row) for row in progress.history]
        self.sent, self.away_until = 0, float("-inf")
        self.first, self.started = progress.step, time.monotonic()
        self.shown_s, self.estimate = -LINE_EVERY_S, Estimate(steps, progress.step)

    def on_fit_start(self, trainer: lightning.Trainer, pl_module: lightning.LightningModule) -> None:
        """Fill the module from the checkpoint; its tensors are where they stay by now."""
        del trainer
        checkpoint = self.folder.latest()
        if checkpoint is not None and isinstance(pl_module, TrialModule):
            load_checkpoint(checkpoint, pl_module)
        self.started, self.estimate = time.monotonic(), Estimate(self.steps, self.first)

    def on_train_batch_end(
        self,
        trainer: lightning.Trainer,
        pl_module: lightning.LightningModule,
        outputs: Any,
        batch: Any,
        batch_idx: int,
    ) -> None:
        """Log, checkpoint, or neither; and end where that is asked for."""
        del outputs, batch, batch_idx
        self.step += 1
        last, first = self.step == self.steps, self.step == self.first + 1
        if not isinstance(pl_module, TrialModule):
            return
        if first or last or self.step % self.resources.log_every_steps == 0:
            self._log(pl_module)
        self.stopped = not last and self._should_stop()
        if last or self.stopped or self.step % self.resources.checkpoint_every_steps == 0:
            self._checkpoint(pl_module)
        trainer.should_stop = self.stopped

    def _log(self, module: TrialModule) -> None:
        elapsed = time.monotonic() - self.started
        rate = (self.step - self.first) / max(elapsed, 1e-9)
        metrics = module.metrics() | {"steps_per_s": rate}
        now_ms = time.time_ns() // 1_000_000
        self.history.append({"step": float(self.step), "time_ms": float(now_ms), **metrics})
        if elapsed - self.shown_s < LINE_EVERY_S and self.step < self.steps:
            return
        self.shown_s = elapsed
        shown = ", ".join(f"{key} {value:.4g}" for key, value in metrics.items() if key != "steps_per_s")
        left = self.estimate.left(self.step)
        _LOG.info("%s: step %d/%d, %s%s", self.name, self.step, self.steps, shown, left)

    def _should_stop(self) -> bool:
        now = time.monotonic()
        if now - self.looked_s < STOP_LOOK_EVERY_S:
            return False
        self.looked_s = now
        return self.stopping()

    def _checkpoint(self, module: TrialModule) -> None:
        # First the checkpoint: a trial that goes on from it sends the same points again, and no others.
        self.folder.save(module, Progress(self.step, self.run.run_id, tuple(self.history)))
        if time.monotonic() < self.away_until:
            return
        try:
            self.run.history(self.history[self.sent :])
            self.sent = len(self.history)
        except RegistryUnavailableError as error:
            _LOG.warning("%s: metrics are sent later: %s", self.name, error)
            self.away_until = time.monotonic() + RETRY_S


def fit(
    name: str,
    module: TrialModule,
    steps: int,
    resources: ResourceConfig,
    run: RunLog,
    folder: TrialFolder,
    stopping: Callable[[], bool] = lambda: False,
) -> Metrics:
    """Train ``module`` up to ``steps``, from the last checkpoint when there is one.

    Returns:
        The last metrics.
    """
    checkpoint = folder.latest()
    progress = Progress(0, run.run_id, ()) if checkpoint is None else read_progress(checkpoint)
    callback = TrialCallback(name, progress, steps, resources, run, folder, stopping)
    with warnings.catch_warnings():
        # Lightning counsels on loader workers and loggers; the loader only counts steps.
        warnings.simplefilter("ignore")
        trainer = lightning.Trainer(
            accelerator="auto",
            devices=1,
            min_epochs=0,
            max_epochs=1,
            logger=False,
            enable_checkpointing=False,
            enable_progress_bar=False,
            enable_model_summary=False,
            callbacks=[callback],
        )
        with run:
            # A worker may have been killed between a trial's last checkpoint and its outcome.
            if progress.step < steps:
                trainer.fit(module, DataLoader(StepCounter(progress.step, steps), batch_size=None))
            if callback.stopped:
                raise TrialStopped
            run.history(callback.history[callback.sent :])
    return last_metrics(callback.history)


def fit_tracked(
    trial: TrialRequest,
    module: TrialModule,
    settings: TrialSettings,
    resources: ResourceConfig,
    tracking_uri: str,
    **extra_parameters: Any,
) -> Metrics | None:
    """Train a trial's module, from its last checkpoint on where it has one.

    Training goes on while the tracking server is away: the metrics are in the checkpoint. What the server
    lacks is sent when the trial ends, else by the job's driver. A job that is being stopped ends it early,
    with a checkpoint.

    Returns:
        The last metrics; None where the job is being stopped.
    """
    # No more threads than the trial claims: two pools on the same cores are slower than one thread each.
    torch.set_num_threads(resources.threads)
    logging.basicConfig(level=logging.WARNING, format="%(message)s", force=True)
    logging.getLogger("training").setLevel(logging.INFO)
    logging.getLogger("lightning.pytorch").setLevel(logging.ERROR)
    # What can not be sent is sent later, so there is nothing to be patient for.
    set_timeouts(os.environ)
    label = f"{trial.name} ({trial.job})"
    folder = TrialFolder(trial.folder, resources.checkpoints_kept)
    if trial.start is not None:
        start_from(trial.start, module)
        _LOG.info("%s: starts from the weights of %s", label, trial.start)
    run = RunLog(Tracking(tracking_uri), trial.run_id)
    parameters = _parameters(trial, module, settings) | extra_parameters
    try:
        run.params(parameters)
    except RegistryUnavailableError:
        _LOG.warning("%s: the tracking server is away; training goes on", label)
    except RegistryError as error:
        # A trial may go on where another version of the code began it.
        _LOG.warning("run %s: other parameters than it began with: %s", run.run_id, error)
    try:
        return fit(label, module, settings.steps, resources, run, folder, trial.stop.exists)
    except TrialStopped:
        return None
    except RegistryUnavailableError as error:
        _LOG.warning("%s: the job sends the metrics when it ends: %s", label, error)
        write_json(trial.folder / MISSED, parameters)
        return last_metrics(read_progress(folder.checkpoints()[-1]).history)


def last_metrics(history: Sequence[Mapping[str, float]]) -> Metrics:
    """Of a trial's last row."""
    return {name: value for name, value in history[-1].items() if name not in ("step", "time_ms")}


def _parameters(trial: TrialRequest, module: TrialModule, settings: TrialSettings) -> dict[str, Any]:
    """What trials are compared by; settings keep their names."""
    cluster = {} if trial.cluster is None else {"cluster": trial.cluster}
    device = "cuda" if torch.cuda.is_available() else "cpu"
    sizes = {"parameters": sum(one.numel() for one in module.parameters())}
    return settings.to_dict() | cluster | sizes | {"seed": trial.seed, "device": device}
