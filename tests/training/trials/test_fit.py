import shutil

import pytest
import torch

from tests.fakes.run_log import RecordingRun
from tests.training.models.builders import tiny_module
from training.models.checkpoint import read_progress
from training.trials.fit import Rhythm, fit


class Keeper:
    """Copies checkpoints as Tune does; fails after a number of them when asked to."""

    def __init__(self, folder, fail_after=None):
        self.folder, self.fail_after, self.kept = folder, fail_after, 0

    def __call__(self, metrics, checkpoint):
        if checkpoint is None:
            return
        self.kept += 1
        shutil.copytree(checkpoint, self.folder, dirs_exist_ok=True)
        if self.kept == self.fail_after:
            raise RuntimeError("stopped")


def train(module, keep, run, checkpoint=None):
    fit("local-0", module, 9, Rhythm(2, 4), run, keep, checkpoint)


def test_a_trial_logs_at_its_rhythm_and_at_its_ends(tmp_path):
    run = RecordingRun()
    train(tiny_module(), Keeper(tmp_path / "c"), run)
    assert [step for step, _ in run.rows] == [1, 2, 4, 6, 8, 9]
    assert {"critic_loss", "generator_loss", "wasserstein_estimate", "steps_per_s"} <= set(run.rows[0][1])
    assert run.status == "FINISHED"


def test_a_trial_ends_with_a_checkpoint_of_its_last_step_and_whole_history(tmp_path):
    train(tiny_module(), Keeper(tmp_path / "c"), RecordingRun())
    progress = read_progress(tmp_path / "c")
    assert progress.step == 9
    assert [row["step"] for row in progress.history] == [1, 2, 4, 6, 8, 9]


def test_a_trial_that_was_stopped_goes_on_from_its_checkpoint_to_the_same_weights(tmp_path):
    whole = tiny_module()
    train(whole, Keeper(tmp_path / "whole"), RecordingRun())
    with pytest.raises(RuntimeError, match="stopped"):
        train(tiny_module(), Keeper(tmp_path / "half", fail_after=1), RecordingRun())
    assert read_progress(tmp_path / "half").step == 4
    resumed, run = tiny_module(), RecordingRun()
    train(resumed, Keeper(tmp_path / "end"), run, tmp_path / "half")
    assert [step for step, _ in run.rows] == [5, 6, 8, 9]
    for name, value in whole.state_dict().items():
        assert torch.equal(value, resumed.state_dict()[name]), name


def test_a_trial_that_fails_leaves_a_failed_run(tmp_path):
    module, run = tiny_module(), RecordingRun()
    module.samples.configurations.resize_(0)
    with pytest.raises(IndexError):
        train(module, Keeper(tmp_path / "c"), run)
    assert run.status == "FAILED"
