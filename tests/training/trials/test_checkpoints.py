"""A trial's checkpoints are whole or not there."""

import pytest

from cspace.errors import JobError
from cspace.files import replacing
from tests.training.models.builders import tiny_module
from training.models.checkpoint import Progress, read_progress
from training.trials.launch import TrialFolder


def save(folder, *steps):
    for step in steps:
        folder.save(tiny_module(), Progress(step, "run", ()))


def test_the_last_checkpoints_stay_by_the_number_of_their_step(tmp_path):
    folder = TrialFolder(tmp_path / "new", keep=2)
    assert folder.latest() is None
    save(folder, 4, 1000, 999_999)
    assert [read_progress(path).step for path in folder.checkpoints()] == [1000, 999_999]
    assert read_progress(folder.latest()).step == 999_999


def test_half_a_checkpoint_is_none_and_goes_with_the_next(tmp_path):
    folder = TrialFolder(tmp_path)
    save(folder, 4)
    half = tmp_path / "step-000000008.tmp"
    half.mkdir()
    (half / "weights.safetensors").write_bytes(b"ha")
    assert read_progress(folder.latest()).step == 4
    save(folder, 12)
    assert [path.name for path in tmp_path.iterdir()] == ["step-000000012"]


def test_a_record_that_the_job_is_writing_survives_a_checkpoint(tmp_path):
    folder, record = TrialFolder(tmp_path), tmp_path / "outcome.json"
    with replacing(record) as beside:
        beside.write_text("{}")
        save(folder, 4)
    assert record.read_text() == "{}"


def test_a_disk_that_is_full_leaves_the_checkpoint_that_was_there(tmp_path, monkeypatch):
    folder = TrialFolder(tmp_path)
    save(folder, 4)

    def full(tensors, path):
        path.write_bytes(b"ha")
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("training.models.checkpoint.save_file", full)
    with pytest.raises(OSError, match="No space"):
        save(folder, 8)
    assert read_progress(folder.latest()).step == 4


def test_a_trial_is_trained_by_one_at_a_time(tmp_path):
    with TrialFolder(tmp_path).alone():
        another = pytest.raises(JobError, match="another process")
        with another, TrialFolder(tmp_path).alone(patience_s=0.3):
            pass
    with TrialFolder(tmp_path).alone(patience_s=0.0):
        assert TrialFolder(tmp_path).latest() is None
