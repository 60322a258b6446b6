"""One trial's training loop: Lightning, with buffered tracking, progress lines and checkpoints."""

import logging
import tempfile
import time
import warnings
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import lightning
from torch.utils.data import DataLoader

from services.registry.tracking import RunLog
from training.models.checkpoint import Progress, load_checkpoint, read_progress, save_checkpoint
from training.models.data import StepCounter
from training.models.modules import Metrics, TrialModule

Keep = Callable[[Metrics, Path | None], None]

# Readers of a log want a line now and then, however fast the steps are.
LINE_EVERY_S = 5.0

_LOG = logging.getLogger("training")


@dataclass(frozen=True, slots=True)
class Rhythm:
    """How often a trial logs and checkpoints, in steps."""

    log_every_steps: int
    checkpoint_every_steps: int


class TrialCallback(lightning.Callback):
    """Reports a trial's metrics and keeps its checkpoints.

    Args:
        name: the trial's name in progress lines.
        progress: where it starts.
        steps: where it ends.
        rhythm: how often it reports.
        run: its tracking run.
        keep: takes metrics and, when there is one, a checkpoint's folder.
        resume: a checkpoint to fill the module from, once it is on its device.
    """

    def __init__(
        self,
        name: str,
        progress: Progress,
        steps: int,
        rhythm: Rhythm,
        run: RunLog,
        keep: Keep,
        resume: Path | None,
    ) -> None:
        self.name, self.step, self.steps = name, progress.step, steps
        self.rhythm, self.run, self.keep, self.resume = rhythm, run, keep, resume
        self.history = [dict(row) for row in progress.history]
        self.first, self.started = progress.step, time.monotonic()
        self.shown_s = -LINE_EVERY_S

    def on_fit_start(self, trainer: lightning.Trainer, pl_module: lightning.LightningModule) -> None:
        """Fill the module from the checkpoint; its tensors are where they stay by now."""
        del trainer
        if self.resume is not None and isinstance(pl_module, TrialModule):
            load_checkpoint(self.resume, pl_module)
        self.started = time.monotonic()

    def on_train_batch_end(
        self,
        trainer: lightning.Trainer,
        pl_module: lightning.LightningModule,
        outputs: Any,
        batch: Any,
        batch_idx: int,
    ) -> None:
        """Log, checkpoint, or neither."""
        del trainer, outputs, batch, batch_idx
        self.step += 1
        last, first = self.step == self.steps, self.step == self.first + 1
        if not isinstance(pl_module, TrialModule):
            return
        if first or last or self.step % self.rhythm.log_every_steps == 0:
            self._log(pl_module)
        if last or self.step % self.rhythm.checkpoint_every_steps == 0:
            self._checkpoint(pl_module)
        elif first:
            self.keep(self._row(), None)

    def _log(self, module: TrialModule) -> None:
        elapsed = time.monotonic() - self.started
        rate = (self.step - self.first) / max(elapsed, 1e-9)
        metrics = module.metrics() | {"steps_per_s": rate}
        self.history.append({"step": float(self.step), **metrics})
        self.run.metrics(metrics, self.step)
        if elapsed - self.shown_s < LINE_EVERY_S and self.step < self.steps:
            return
        self.shown_s = elapsed
        left = (self.steps - self.step) / max(rate, 1e-9)
        shown = ", ".join(f"{key} {value:.4g}" for key, value in metrics.items() if key != "steps_per_s")
        _LOG.info("%s: step %d/%d, %s, %.0f s left", self.name, self.step, self.steps, shown, left)

    def _row(self) -> Metrics:
        return dict(self.history[-1])

    def _checkpoint(self, module: TrialModule) -> None:
        progress = Progress(self.step, self.run.run_id, tuple(self.history))
        with tempfile.TemporaryDirectory(prefix="trial-") as folder:
            self.run.flush()
            self.keep(self._row(), save_checkpoint(Path(folder) / "checkpoint", module, progress))


def fit(
    name: str,
    module: TrialModule,
    steps: int,
    rhythm: Rhythm,
    run: RunLog,
    keep: Keep,
    checkpoint: Path | None = None,
) -> None:
    """Train ``module`` up to ``steps``, from a checkpoint when there is one.

    Args:
        name: the trial's name.
        module: what is trained; its batches are its own.
        steps: generator steps in all.
        rhythm: how often it reports.
        run: its tracking run, finished here.
        keep: takes metrics and checkpoints.
        checkpoint: folder of an earlier attempt's checkpoint.
    """
    progress = Progress(0, run.run_id, ()) if checkpoint is None else read_progress(checkpoint)
    callback = TrialCallback(name, progress, steps, rhythm, run, keep, checkpoint)
    with warnings.catch_warnings():
        # Lightning counsels on loader workers and loggers; the loader only counts steps.
        warnings.simplefilter("ignore")
        trainer = lightning.Trainer(
            accelerator="auto",
            devices=1,
            max_epochs=1,
            logger=False,
            enable_checkpointing=False,
            enable_progress_bar=False,
            enable_model_summary=False,
            callbacks=[callback],
        )
        with run:
            trainer.fit(module, DataLoader(StepCounter(progress.step, steps), batch_size=None))
