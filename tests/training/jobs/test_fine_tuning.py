"""Fine-tuning: which job a new one starts from, and what does not fit, told before anything starts."""

import json
import shutil

import numpy as np
import pytest

from cspace.errors import ConfigError, ModelNotFoundError
from inference_api.settings import PRETRAINED_FOLDER
from services.registry.entities import ModelVersion
from tests.fakes.registry import FakeRun, FakeTracking
from tests.training.models.builders import save, tiny_module
from training.config import CLUSTERS_FILE, PathTrainConfig, TrainConfig
from training.jobs.job import CONFIGURATION, TAG_START, Environment, Job, job_folder
from training.jobs.launch import FINAL, TrialRequest
from training.models.checkpoint import start_from

EARLIER, CHILD = "a" * 32, "c" * 32
SMOKE = TrainConfig.load("smoke")


class Registry:
    """One version, made by the earlier job, or by one of its trials."""

    run_id = EARLIER

    def look_up(self, reference):
        if str(reference) not in ("cspace-sampler@champion", "cspace-sampler/3"):
            raise ModelNotFoundError("there is no such alias")
        return ModelVersion(reference.name, 3, self.run_id, "", ("champion",), {}, 0)


@pytest.fixture
def tracking(monkeypatch):
    tracking = FakeTracking()
    tracking.runs[EARLIER] = FakeRun(EARLIER, "cspace-sampler", "earlier", None)
    tracking.runs[CHILD] = FakeRun(CHILD, "cspace-sampler", "vae", EARLIER)
    monkeypatch.setattr("training.jobs.job.Tracking", lambda uri, **spool: tracking)
    monkeypatch.setattr("training.jobs.job.ModelRegistry", lambda uri: Registry())
    return tracking


@pytest.fixture
def environment(tmp_path):
    """A data folder with the earlier job, finished."""
    environment = Environment("unused", tmp_path, patience_s=0.0)
    folder = job_folder(environment, EARLIER)
    (folder / "bundle").mkdir(parents=True)
    shutil.copy(PRETRAINED_FOLDER / "bundle.json", folder / "bundle")
    (folder / CONFIGURATION).write_text(json.dumps(SMOKE.to_dict()))
    np.savez(folder / CLUSTERS_FILE, centres=np.zeros((2, 4)), clusters=np.arange(2))
    (folder / "local" / "local-0").mkdir(parents=True)
    (folder / "local" / "local-0" / FINAL).touch()
    return environment


def start(environment, text, *overrides, name=None):
    config = TrainConfig.load("smoke", [f"start_from={text}", *overrides])
    return Job.start(config, environment, {"preset": "smoke"}, name=name)


@pytest.mark.parametrize("text", ["cspace-sampler@champion", "cspace-sampler/3", EARLIER, CHILD])
def test_a_version_and_a_run_mean_the_job_that_made_them(text, environment, tracking):
    job = start(environment, text)
    assert job.start_folder == job_folder(environment, EARLIER)
    tags = tracking.runs[job.run.run_id].tags
    assert (tags["start_from"], tags[TAG_START]) == (text, EARLIER)


def test_a_trial_starts_from_the_last_checkpoint_of_its_namesake(environment, tracking):
    # Budgets and data may differ.
    job = start(environment, EARLIER, "local.steps=9", "seed=5", "data.seed=7", "data.scenario_count=30")
    known = job.start_folder / "local" / "local-0" / FINAL
    assert TrialRequest.of(job, "local", "local-0").start == known
    assert TrialRequest.of(job, "pictures", "vae").start is None


def test_a_job_goes_on_from_what_it_began_with_wherever_the_alias_points_by_now(
    environment, tracking, monkeypatch
):
    first = start(environment, "cspace-sampler@champion", name="night")
    monkeypatch.setattr(Registry, "run_id", first.run.run_id)
    again = start(environment, "cspace-sampler@champion", name="night")
    assert (again.run.run_id, again.start_run_id) == (first.run.run_id, EARLIER)
    assert Job.resume(first.run.run_id, environment, TrainConfig).start_run_id == EARLIER


def test_weights_that_are_gone_are_told_as_that(environment, tracking):
    shutil.rmtree(job_folder(environment, EARLIER))
    with pytest.raises(ConfigError, match="weights that start_from means are gone"):
        start(environment, "cspace-sampler@champion")
    assert set(tracking.runs) == {EARLIER, CHILD}


@pytest.mark.parametrize(
    ("overrides", "message"),
    [
        (["local.hidden=24"], r"local\.hidden;? .*expected local\.hidden=16; got local\.hidden=24"),
        (["clusters.count=3", "vae.width=8"], r"clusters\.count, vae\.width"),
        (["data.robot.link_lengths_m=[1.6, 1.4, 1.0]"], r"another robot or camera .*data\.robot"),
    ],
)
def test_other_sizes_and_other_robots_are_refused_by_their_setting(overrides, message, environment, tracking):
    with pytest.raises(ConfigError, match=message):
        start(environment, EARLIER, *overrides)
    assert set(tracking.runs) == {EARLIER, CHILD}


def test_scenarios_by_their_ids_cannot_be_gone_on_with():
    with pytest.raises(ConfigError, match="critic_condition=latent"):
        TrainConfig.load("smoke", [f"start_from={EARLIER}", "global.critic_condition=projection"])


def test_what_a_job_unfinished_or_of_another_kind_did_not_leave_is_named(environment, tracking):
    with pytest.raises(ConfigError, match="another kind"):
        Job.start(PathTrainConfig.load("paths", [f"start_from={EARLIER}"]), environment, {})
    folder = job_folder(environment, EARLIER)
    (folder / "bundle" / "bundle.json").unlink()
    with pytest.raises(ConfigError, match="has not finished"):
        start(environment, EARLIER)


def test_a_module_takes_what_was_learned_and_keeps_what_follows_from_its_own_data(tmp_path):
    earlier, fresh = tiny_module(), tiny_module(seed=1)
    kept = {name: value.clone() for name, value in fresh.named_buffers()}
    start_from(save(tmp_path / "final.ckpt", earlier), fresh)
    for (name, one), other in zip(earlier.named_parameters(), fresh.parameters(), strict=True):
        assert np.array_equal(one.detach(), other.detach()), name
    assert all(np.array_equal(value, kept[name]) for name, value in fresh.named_buffers())
    assert all(not optimiser.state for optimiser in fresh.training_optimisers)
