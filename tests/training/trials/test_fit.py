import pytest
import torch

from tests.fakes.run_log import RecordingRun
from tests.training.models.builders import tiny_module
from training.config import ResourceConfig
from training.models.checkpoint import read_progress
from training.trials.fit import TrialStopped, fit
from training.trials.launch import TrialFolder


class KilledAt(RecordingRun):
    """A run whose trial ends without warning when it logs a step."""

    def __init__(self, step):
        super().__init__()
        self.step = step

    def metrics(self, metrics, step):
        if step == self.step:
            raise RuntimeError("killed")
        super().metrics(metrics, step)


def train(module, folder, run, stopping=lambda: False):
    """Nine steps, logged every 2 and kept every 4; returns the last metrics."""
    resources = ResourceConfig(log_every_steps=2, checkpoint_every_steps=4)
    return fit("local-0", module, 9, resources, run, TrialFolder(folder), stopping)


def last(folder):
    return read_progress(TrialFolder(folder).latest())


def test_a_trial_logs_at_its_rhythm_and_keeps_its_last_step_with_its_whole_history(tmp_path):
    run = RecordingRun()
    metrics = train(tiny_module(), tmp_path, run)
    assert [step for step, _ in run.rows] == [1, 2, 4, 6, 8, 9]
    assert {"critic_loss", "generator_loss", "wasserstein_estimate", "steps_per_s"} <= set(run.rows[0][1])
    assert run.status == "FINISHED"
    assert last(tmp_path).step == 9
    assert [row["step"] for row in last(tmp_path).history] == [1, 2, 4, 6, 8, 9]
    assert (9, metrics) == run.rows[-1]
    # What had come to its end trains nothing and has the same metrics.
    again = RecordingRun()
    assert train(tiny_module(), tmp_path, again) == metrics
    assert again.rows == []
    assert again.status == "FINISHED"


def same_weights(one, other):
    return all(torch.equal(value, other.state_dict()[name]) for name, value in one.state_dict().items())


def test_a_trial_that_was_killed_goes_on_from_its_checkpoint_to_the_same_weights(tmp_path):
    whole = tiny_module()
    train(whole, tmp_path / "whole", RecordingRun())
    with pytest.raises(RuntimeError, match="killed"):
        train(tiny_module(), tmp_path / "half", KilledAt(6))
    assert last(tmp_path / "half").step == 4
    resumed, run = tiny_module(), RecordingRun()
    train(resumed, tmp_path / "half", run)
    assert [step for step, _ in run.rows] == [5, 6, 8, 9]
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
