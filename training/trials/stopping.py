"""Stopping a job without loss: what a SIGTERM, as of ``ray job stop``, does to the driver and its trials."""

import logging
import os
import signal
import threading
from pathlib import Path
from types import FrameType, TracebackType
from typing import Any, Self

from ray import tune
from ray.tune.experiment import Trial

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
