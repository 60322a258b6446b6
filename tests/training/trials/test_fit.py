import pytest
import torch

from cspace.errors import RegistryUnavailableError
from tests.fakes.run_log import RecordingRun
from tests.training.models.builders import tiny_module
from training.config import ResourceConfig
from training.models.checkpoint import read_progress
from training.trials.fit import TrialStopped, fit
from training.trials.launch import TrialFolder


class Killed(RecordingRun):
    """A run whose trial ends without warning at its first checkpoint, before anything was sent."""

    def history(self, rows):
        raise RuntimeError("killed")


class Away(RecordingRun):
    """A run whose server is away for the first checkpoints."""

    def __init__(self, times):
        super().__init__()
        self.times = times

    def history(self, rows):
        self.times -= 1
        if self.times >= 0:
            raise RegistryUnavailableError("the server is away")
        super().history(rows)


def train(module, folder, run, stopping=lambda: False):
    """Nine steps, logged every 2 and kept every 4; returns the last metrics."""
    resources = ResourceConfig(log_every_steps=2, checkpoint_every_steps=4)
    return fit("local-0", module, 9, resources, run, TrialFolder(folder), stopping)


def last(folder):
    return read_progress(TrialFolder(folder).latest())


def test_a_trial_logs_at_its_rhythm_and_keeps_its_last_step_with_its_whole_history(tmp_path):
    run = RecordingRun()
    metrics = train(tiny_module(), tmp_path, run)
    assert steps_of(run) == [1, 2, 4, 6, 8, 9]
    assert {"critic_loss", "generator_loss", "wasserstein_estimate", "steps_per_s"} <= set(run.rows[0])
    assert run.status == "FINISHED"
    assert last(tmp_path).step == 9
    assert list(last(tmp_path).history) == run.rows
    assert metrics.items() < run.rows[-1].items()
    # What had come to its end trains nothing, has the same metrics, and sends the same points.
    again = RecordingRun()
    assert train(tiny_module(), tmp_path, again) == metrics
    assert again.rows == run.rows
    assert again.status == "FINISHED"


def steps_of(run):
    return [row["step"] for row in run.rows]


def test_metrics_that_the_server_missed_are_sent_at_the_end(tmp_path):
    run = Away(1)
    train(tiny_module(), tmp_path, run)
    assert (steps_of(run), run.status) == ([1, 2, 4, 6, 8, 9], "FINISHED")
    with pytest.raises(RegistryUnavailableError):
        train(tiny_module(), tmp_path / "away", Away(9))
    assert len(last(tmp_path / "away").history) == 6


def same_weights(one, other):
    return all(torch.equal(value, other.state_dict()[name]) for name, value in one.state_dict().items())


def test_a_trial_that_was_killed_goes_on_from_its_checkpoint_to_the_same_weights(tmp_path):
    whole = tiny_module()
    train(whole, tmp_path / "whole", RecordingRun())
    with pytest.raises(RuntimeError, match="killed"):
        train(tiny_module(), tmp_path / "half", Killed())
    assert last(tmp_path / "half").step == 4
    resumed, run = tiny_module(), RecordingRun()
    train(resumed, tmp_path / "half", run)
    assert steps_of(run) == [1, 2, 4, 5, 6, 8, 9]
    assert same_weights(whole, resumed)


def test_a_trial_that_is_asked_to_stop_writes_a_checkpoint_first_and_loses_no_step(tmp_path, monkeypatch):
    monkeypatch.setattr("training.trials.fit.STOP_LOOK_EVERY_S", 0.0)
    whole, answers = tiny_module(), iter([False] * 5 + [True])
    train(whole, tmp_path / "whole", RecordingRun())
    run = RecordingRun()
    with pytest.raises(TrialStopped):
        train(tiny_module(), tmp_path / "half", run, stopping=lambda: next(answers))
    assert last(tmp_path / "half").step == 6
    assert run.status == "KILLED"
    resumed = tiny_module()
    train(resumed, tmp_path / "half", RecordingRun())
    assert same_weights(whole, resumed)


def test_a_trial_that_fails_leaves_a_failed_run(tmp_path):
    module, run = tiny_module(), RecordingRun()
    module.samples.configurations.resize_(0)
    with pytest.raises(IndexError):
        train(module, tmp_path, run)
    assert run.status == "FAILED"
