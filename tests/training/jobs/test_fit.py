from pathlib import Path

import pytest
import torch

from cspace.errors import RegistryUnavailableError
from tests.fakes.run_log import RecordingRun
from tests.training.models.builders import tiny_module
from training.config import ResourceConfig
from training.jobs.fit import fit
from training.models.checkpoint import read_checkpoint
from training.models.families.wgan_gp import WganGpModule


class Killed(RecordingRun):
    """A run whose trial ends without warning at its first checkpoint, before anything was sent."""

    def history(self, rows):
        if rows:
            raise RuntimeError("killed")


class Away(RecordingRun):
    """A run whose server is away for the first calls."""

    def __init__(self, times):
        super().__init__()
        self.times = times

    def history(self, rows):
        self.times -= 1
        if self.times >= 0:
            raise RegistryUnavailableError("the server is away")
        super().history(rows)


def train(module: WganGpModule, folder: Path, run: RecordingRun) -> dict[str, object]:
    """Nine steps, logged every 2 and kept every 4; the checkpoint."""
    fit("local-0", module, 9, ResourceConfig(log_every_steps=2, checkpoint_every_steps=4), run, folder)
    return read_checkpoint(folder / "last.ckpt")


def test_a_trial_logs_at_its_rhythm_and_keeps_its_last_step_with_its_whole_history(tmp_path):
    run = RecordingRun()
    kept = train(tiny_module(), tmp_path, run)
    assert steps_of(run) == [1, 2, 4, 6, 8, 9]
    assert {"critic_loss", "generator_loss", "wasserstein_estimate", "steps_per_s"} <= set(run.rows[0])
    assert (run.status, kept["global_step"], kept["history"]) == ("FINISHED", 9, run.rows)
    # What had come to its end trains nothing, and sends the same points.
    again = RecordingRun()
    assert train(tiny_module(), tmp_path, again)["history"] == run.rows
    assert (again.rows, again.status) == (run.rows, "FINISHED")


def steps_of(run):
    return [row["step"] for row in run.rows]


def test_metrics_that_the_server_missed_are_sent_at_the_end(tmp_path):
    run = Away(1)
    train(tiny_module(), tmp_path, run)
    assert (steps_of(run), run.status) == ([1, 2, 4, 6, 8, 9], "FINISHED")
    with pytest.raises(RegistryUnavailableError):
        train(tiny_module(), tmp_path / "away", Away(9))
    assert len(read_checkpoint(tmp_path / "away" / "last.ckpt")["history"]) == 6


def test_a_trial_that_was_killed_goes_on_from_its_checkpoint_to_the_same_weights(tmp_path):
    whole = tiny_module()
    train(whole, tmp_path / "whole", RecordingRun())
    with pytest.raises(RuntimeError, match="killed"):
        train(tiny_module(), tmp_path / "half", Killed())
    assert read_checkpoint(tmp_path / "half" / "last.ckpt")["global_step"] == 4
    resumed, run = tiny_module(), RecordingRun()
    train(resumed, tmp_path / "half", run)
    assert steps_of(run) == [1, 2, 4, 6, 8, 9]
    other = resumed.state_dict()
    assert all(torch.equal(value, other[name]) for name, value in whole.state_dict().items())


def test_a_full_disk_leaves_the_checkpoint_that_was_there(tmp_path, monkeypatch):
    train(tiny_module(), tmp_path, RecordingRun())
    before = (tmp_path / "last.ckpt").read_bytes()

    def full(content, path):
        path.write_bytes(b"ha")
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("torch.save", full)
    with pytest.raises(OSError, match="No space"):
        fit("local-0", tiny_module(), 12, ResourceConfig(), RecordingRun(), tmp_path)
    assert [path.name for path in tmp_path.iterdir()] == ["last.ckpt"]
    assert (tmp_path / "last.ckpt").read_bytes() == before


def test_a_trial_that_fails_leaves_a_failed_run(tmp_path):
    module, run = tiny_module(), RecordingRun()
    module.samples.configurations.resize_(0)
    with pytest.raises(IndexError):
        train(module, tmp_path, run)
    assert run.status == "FAILED"
