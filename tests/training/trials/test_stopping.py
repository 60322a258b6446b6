"""A request to stop ends Tune's loop when no trial runs any more, and not before."""

import os
import signal
from dataclasses import dataclass

import pytest
from ray.tune.experiment import Trial

from training.trials import launch
from training.trials.launch import Stop


@dataclass
class Shown:
    """What the callback sees of a trial."""

    status: str


RUNNING, WAITING, ENDED = Shown(Trial.RUNNING), Shown(Trial.PENDING), Shown(Trial.TERMINATED)


@pytest.fixture
def sent(monkeypatch):
    """Signals that would end Tune's loop."""
    sent = []
    monkeypatch.setattr(launch.os, "kill", lambda pid, number: sent.append((pid, number)))
    return sent


def test_the_loop_goes_on_while_nobody_asks(tmp_path, sent):
    with Stop(tmp_path / "stop") as stop:
        stop.on_step_end(1, [ENDED, WAITING])
    assert sent == []


def test_the_loop_waits_for_trials_that_write_their_checkpoints_and_for_no_others(tmp_path, sent):
    (tmp_path / "stop").touch()
    with Stop(tmp_path / "stop") as stop:
        stop.on_step_end(1, [RUNNING, WAITING])
        assert sent == []
        stop.on_step_end(2, [ENDED, WAITING])
    assert sent == [(os.getpid(), signal.SIGUSR1)]


def test_sigterm_is_a_request_while_trials_run_and_nothing_else_changes(tmp_path):
    before = signal.getsignal(signal.SIGTERM)
    with Stop(tmp_path / "stop"):
        signal.raise_signal(signal.SIGTERM)
        assert (tmp_path / "stop").exists()
    assert signal.getsignal(signal.SIGTERM) is before
