import fcntl
import json

import pytest

from cspace.errors import ConfigError, JobError, StorageError
from services.names import TAG_KEY
from tests.fakes.registry import FakeTracking
from training.config import TrainConfig
from training.jobs.environment import RECORD, Environment, job_environment, job_folder, run_of, submission_id
from training.jobs.job import Job, kept_bundle

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


def test_a_driver_that_is_killed_before_it_could_note_its_run_finds_it(environment, tracking, monkeypatch):
    started = tracking.start("cspace-sampler", "cluster-train", key="job/arm-1")
    assert Job.start(SMOKE, environment, {}, name="arm-1").run.run_id == started.run_id
    # The same for a trial's run: it is there, and the record does not know of it.
    job = Job.start(SMOKE, environment, {}, name="arm-1")
    child = job.child("vae")
    path = job.folder / RECORD
    path.write_text(json.dumps(json.loads(path.read_text()) | {"children": {}}))
    assert Job.start(SMOKE, environment, {}, name="arm-1").child("vae") == child
    assert tracking.runs[child].tags[TAG_KEY] == f"{job.run.run_id}/vae"


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
        (job.folder / "running.json").write_text('{"submission_id": "raysubmit_1"}')
        refused = pytest.raises(JobError, match=r"submitted as raysubmit_1; .*ray job stop raysubmit_1")
        with refused, job.running():
            pass
    with job.running() as run:
        assert run.run_id == job.run.run_id
    assert tracking.runs[job.run.run_id].status == "FINISHED"


def test_a_submitted_job_says_first_how_to_stop_it_and_keeps_rays_id_while_it_runs(
    environment, tracking, monkeypatch, caplog
):
    job_config = {"runtime_env": {}, "metadata": {"job_submission_id": "raysubmit_1"}}
    monkeypatch.setenv("RAY_JOB_CONFIG_JSON_ENV_VAR", json.dumps(job_config))
    job = Job.start(SMOKE, environment, {}, name="arm-1")
    with caplog.at_level("INFO", logger="training"), job.running():
        assert json.loads((job.folder / "running.json").read_text()) == {"submission_id": "raysubmit_1"}
    first, _, stop, follow = caplog.messages[:4]
    assert first == f"run: {job.run.run_id}"
    assert stop.endswith("ray job stop raysubmit_1")
    assert follow.endswith("ray job logs --follow raysubmit_1")
    assert not (job.folder / "running.json").exists()


def test_a_job_that_nobody_submitted_says_nothing_of_it(environment, tracking, monkeypatch, caplog):
    monkeypatch.delenv("RAY_JOB_CONFIG_JSON_ENV_VAR", raising=False)
    with caplog.at_level("INFO", logger="training"), Job.start(SMOKE, environment, {}).running() as run:
        assert caplog.messages == [f"run: {run.run_id}"]
    assert submission_id({"RAY_JOB_CONFIG_JSON_ENV_VAR": '{"metadata": null}'}) is None


def test_what_an_attempt_left_half_is_gone_in_the_next(environment, tracking):
    job = Job.start(SMOKE, environment, {}, name="arm-1")
    (job.folder / "local").mkdir()
    (job.folder / "local" / ".write-last.ckpt-1.tmp").touch()
    (job.folder / ".bundle-abc").mkdir()
    with Job.start(SMOKE, environment, {}, name="arm-1").running():
        assert sorted(path.name for path in job.folder.rglob("*")) == ["job.json", "local", "lock"]


def test_an_interrupted_job_is_a_killed_run(environment, tracking):
    job = Job.start(SMOKE, environment, {})
    with pytest.raises(KeyboardInterrupt), job.running():
        raise KeyboardInterrupt
    assert tracking.runs[job.run.run_id].status == "KILLED"


def test_a_folder_that_can_not_be_written_or_has_no_room_is_told_before_the_work(
    environment, tracking, monkeypatch
):
    file = environment.data_folder / "file"
    file.write_text("")
    with pytest.raises(StorageError, match="cannot be written"):
        Job.start(SMOKE, Environment("unused", file / "data"), {})
    monkeypatch.setattr("cspace.dataset.RESERVE_BYTES", 2**62)
    with pytest.raises(StorageError, match="too full"):
        Job.start(SMOKE, environment, {})
    assert tracking.runs == {}


def test_half_a_bundle_is_not_kept(tmp_path):
    assert kept_bundle(tmp_path / "none") is None
    (tmp_path / "half").mkdir()
    (tmp_path / "half" / "bundle.json").write_text("{}")
    assert kept_bundle(tmp_path / "half") is None


def test_the_patience_is_a_setting(monkeypatch, tmp_path):
    monkeypatch.setenv("MLFLOW_TRACKING_URI", "http://127.0.0.1:1")
    monkeypatch.setenv("CSPACE_DATA_DIR", str(tmp_path))
    assert job_environment().patience_s == 600.0
    monkeypatch.setenv("CSPACE_TRACKING_PATIENCE_S", "5")
    assert job_environment().patience_s == 5.0
    monkeypatch.setenv("CSPACE_TRACKING_PATIENCE_S", "long")
    with pytest.raises(ConfigError, match="seconds"):
        job_environment()


def test_a_job_is_found_by_its_name_within_the_data_folder(environment, tracking):
    assert job_folder(environment, "../../run") == environment.data_folder / "jobs" / "run"
    job = Job.start(SMOKE, environment, {}, name="point")
    assert run_of(environment, "point") == job.run.run_id
    assert run_of(environment, "nobody") is None
