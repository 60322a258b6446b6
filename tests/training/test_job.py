import json

import pytest

from cspace.errors import ConfigError
from tests.fakes.registry import FakeTracking
from training.config import TrainConfig, load_config
from training.environment import Environment
from training.job import RECORD, Job, job_folder


@pytest.fixture
def environment(tmp_path):
    return Environment("unused", tmp_path)


def started(environment, tracking):
    run = tracking.start("experiment", "cluster-train")
    folder = job_folder(environment, run.run_id)
    folder.mkdir(parents=True)
    return Job(load_config("smoke", ["seed=4"]), environment, tracking, run, folder, {})


def test_a_trial_keeps_its_run_however_often_it_is_asked_for(environment):
    job = started(environment, FakeTracking())
    assert job.child("global") == job.child("global") != job.child("vae")


def test_the_record_holds_what_a_resumed_job_needs(environment, monkeypatch):
    tracking = FakeTracking()
    job = started(environment, tracking)
    child = job.child("global")
    monkeypatch.setattr("training.job.MlflowTracking", lambda uri: tracking)
    resumed = Job.resume(job.run.run_id, environment, TrainConfig)
    assert resumed.config == job.config
    assert resumed.child("global") == child
    assert resumed.run.run_id == job.run.run_id
    assert json.loads((resumed.folder / RECORD).read_text())["children"] == {"global": child}


@pytest.mark.parametrize("run_id", ["nothing", "", "../.."])
def test_a_job_that_never_was_is_an_error_that_says_what_to_give(environment, run_id):
    with pytest.raises(ConfigError, match="run's id"):
        Job.resume(run_id, environment, TrainConfig)
