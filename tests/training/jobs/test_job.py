import fcntl
import json

import pytest

from cspace.errors import ConfigError, JobError, StorageError
from tests.fakes.registry import FakeTracking
from training.config import TrainConfig
from training.jobs.job import (
    LONGEST,
    Environment,
    Job,
)

SMOKE = TrainConfig.load("smoke", ["seed=4"])


@pytest.fixture
def environment(tmp_path):
    return Environment("unused", tmp_path, patience_s=0.0)


@pytest.fixture
def tracking(monkeypatch):
    tracking = FakeTracking()
    monkeypatch.setattr("training.jobs.job.Tracking", lambda uri, **spool: tracking)
    return tracking


def test_a_trial_keeps_its_run_however_often_it_is_asked_for_and_in_a_resumed_job(environment, tracking):
    job = Job.start(SMOKE, environment, {})
    child = job.child("global")
    assert job.child("global") == child != job.child("vae")
    assert len(tracking.runs) == 3
    resumed = Job.resume(job.run.run_id, environment, TrainConfig)
    assert resumed.config == job.config
    assert resumed.child("global") == child
    assert resumed.run.run_id == job.run.run_id


def test_settings_are_parameters_one_each_and_a_file_has_all_of_them(environment, tracking):
    config = TrainConfig.load("quickstart", [f"data_folder=/{LONGEST * 'x'}"])
    job = Job.start(config, environment, {})
    job.log_configuration()
    kept = tracking.runs[job.run.run_id]
    assert kept.params["local.steps"] == str(config.local.steps)
    assert "data_folder" not in kept.params
    assert not any(value == "None" or len(value) > LONGEST for value in kept.params.values())
    assert json.loads(kept.artifacts["configuration.json"]) == config.to_dict()


@pytest.mark.parametrize("run_id", ["nothing", "../.."])
def test_a_job_that_never_was_is_an_error_that_says_what_to_give(environment, run_id):
    with pytest.raises(ConfigError, match="run's id"):
        Job.resume(run_id, environment, TrainConfig)


def test_a_name_names_one_job_and_those_without_one_are_different_ones(environment, tracking):
    assert Job.start(SMOKE, environment, {}).folder != Job.start(SMOKE, environment, {}).folder
    tracking.runs.clear()
    first = Job.start(SMOKE, environment, {"preset": "smoke"}, name="arm-1")
    child = first.child("vae")
    again = Job.start(SMOKE, environment, {"preset": "smoke"}, name="arm-1")
    other = Job.start(SMOKE, environment, {}, name="arm-2")
    assert (again.run.run_id, again.child("vae")) == (first.run.run_id, child)
    assert other.run.run_id != first.run.run_id
    assert len(tracking.runs) == 3


def test_a_driver_that_is_killed_before_it_could_note_its_run_finds_it(environment, tracking):
    started = tracking.start("cspace-sampler", "cluster-train", tags={"job": "arm-1"}, key="job/arm-1")
    assert Job.start(SMOKE, environment, {}, name="arm-1").run.run_id == started.run_id


def test_a_name_of_other_settings_is_refused_with_the_difference(environment, tracking):
    Job.start(SMOKE, environment, {}, name="arm-1")
    with pytest.raises(ConfigError, match=r"seed=4; got seed=5; .*--resume"):
        Job.start(TrainConfig.load("smoke", ["seed=5"]), environment, {}, name="arm-1")


@pytest.mark.parametrize("name", ["", "-a", "../a", "a b", "ä", "x" * 64])
def test_a_name_that_is_none_is_refused(environment, name):
    with pytest.raises(ConfigError, match="letters, digits"):
        Job.start(SMOKE, environment, {}, name=name)


def test_a_job_that_runs_is_not_run_twice(environment, tracking):
    job = Job.start(SMOKE, environment, {}, name="arm-1")
    with (job.folder / "lock").open("a") as handle:
        fcntl.flock(handle, fcntl.LOCK_EX)
        with pytest.raises(JobError, match=r"running already; got run [0-9a-f]+; wait"), job.running():
            pass
    with job.running() as run:
        assert run.run_id == job.run.run_id
    assert tracking.runs[job.run.run_id].status == "FINISHED"


def test_what_an_attempt_left_half_is_gone_in_the_next(environment, tracking):
    job = Job.start(SMOKE, environment, {}, name="arm-1")
    (job.folder / "local").mkdir()
    (job.folder / "local" / ".write-last.ckpt-1.tmp").touch()
    (job.folder / ".bundle-abc").mkdir()
    with Job.start(SMOKE, environment, {}, name="arm-1").running():
        assert sorted(path.name for path in job.folder.rglob("*")) == ["configuration.json", "local", "lock"]


def test_an_interrupted_job_is_a_killed_run(environment, tracking):
    job = Job.start(SMOKE, environment, {})
    with pytest.raises(KeyboardInterrupt), job.running():
        raise KeyboardInterrupt
    assert tracking.runs[job.run.run_id].status == "KILLED"


def test_a_folder_that_can_not_be_written_is_told_before_the_work(environment, tracking):
    file = environment.data_folder / "file"
    file.write_text("")
    with pytest.raises(StorageError, match="cannot be written"):
        Job.start(SMOKE, Environment("unused", file / "data"), {})
    assert tracking.runs == {}
