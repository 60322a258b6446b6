"""The job of path models on a real Ray and a real MLflow server: what it registers, serves and resumes."""

import numpy as np
import pytest
from mlflow import MlflowClient

from cspace.bundle import Bundle
from cspace.bundle.files import scene
from cspace.errors import ConfigError
from inference_api.settings import PRETRAINED_FOLDER
from services.names import ALIAS_CHALLENGER, EXPERIMENT, PATH_MODEL_NAME
from services.registry.models import ModelRegistry
from tests.bundles import write_tiny_bundle
from tests.fakes.registry import FakeRegistry
from tests.space_bundle import WORLD, write_space_bundle
from tests.training.clusters.test_pipeline import bundle_of, submit
from training.config import PathTrainConfig
from training.paths import source_bundle

JOB = "path_train.py"
START, GOAL = (0.5, 0.5), (-0.5, -1.0)
WHITE = np.full((48, 48, 3), 255, dtype=np.uint8)


def runs_jobs(test):
    """Mark a test that runs jobs."""
    return pytest.mark.e2e(pytest.mark.slow(pytest.mark.timeout(600)(test)))


def train(uri, data_folder, *overrides):
    parts = [part for override in overrides for part in ("--set", override)]
    return submit(uri, data_folder, "--preset", "smoke", *parts, script=JOB)


@pytest.fixture(scope="module")
def result(server, data_folder):
    return train(server, data_folder, f"source={PRETRAINED_FOLDER}")


@runs_jobs
def test_the_model_is_a_version_that_samples_between_start_and_goal(result, server, tmp_path):
    registry = ModelRegistry(server)
    version = registry.by_alias(PATH_MODEL_NAME, ALIAS_CHALLENGER)
    assert version.number == result["version"]
    bundle = Bundle.load(registry.download(version, tmp_path / "wgan"))
    assert (bundle.spec.kind, bundle.digest) == ("path", result["digest"])
    samples = bundle.sample(WHITE, 20, 1, start=START, goal=GOAL).samples
    assert len(np.unique(samples, axis=0)) > 10
    assert bundle.spec.provenance.data_digest == result["data_digest"]
    assert bundle.spec.provenance.metrics["training_s"] > 0


@runs_jobs
def test_the_trial_can_be_compared_in_the_tracking_server(result, server):
    client = MlflowClient(server)
    experiment = client.get_experiment_by_name(EXPERIMENT).experiment_id
    runs = client.search_runs([experiment], f"tags.mlflow.parentRunId = '{result['run_id']}'")
    (run,) = runs
    assert (run.data.tags["trial"], run.info.status) == ("wgan", "FINISHED")
    assert {"wasserstein_estimate", "generator_loss"} <= set(run.data.metrics)
    parent = client.get_run(result["run_id"])
    assert parent.data.params["points"] == "64"


@runs_jobs
def test_a_resumed_job_trains_nothing_twice_and_registers_the_same(result, server, data_folder):
    again = submit(server, data_folder, "--resume", result["run_id"], script=JOB)
    assert (again["run_id"], again["trials"]) == (result["run_id"], result["trials"])
    assert again["data_digest"] == result["data_digest"]


def test_a_source_is_a_folder_or_a_registered_version(tmp_path):
    folder = write_tiny_bundle(tmp_path / "bundle", validity=True)
    registry = FakeRegistry(tmp_path / "registry")
    bundle = source_bundle(str(folder), registry, tmp_path / "fetched")
    assert bundle.folder == folder
    registry.register("sampler", folder, "run", bundle.digest, {}, alias="champion")
    for index, reference in enumerate(("sampler@champion", "sampler/1")):
        fetched = source_bundle(reference, registry, tmp_path / f"fetched{index}")
        assert fetched.digest == bundle.digest
        assert fetched.folder != folder
    with pytest.raises(ConfigError, match="name@alias"):
        source_bundle("nowhere", registry, tmp_path / "other")


def test_every_preset_is_a_configuration():
    for preset in ("paths", "smoke", "paper"):
        assert PathTrainConfig.load(preset).preset == preset


@runs_jobs
def test_an_arm_in_space_takes_the_same_job(server, data_folder, tmp_path):
    source = write_space_bundle(tmp_path / "source")
    settings = ("data.robot=panda", "data.scenario_count=2", "data.shard_size=1", "data.narrow_share=0")
    made = train(server, data_folder, f"source={source}", *settings)
    assert made["model"] == "panda-path-sampler"
    start, goal = WORLD.space.sample_uniform(np.random.default_rng(0), 2)
    picture = scene(WORLD.sensor.picture_shape)
    bundle = bundle_of(server, made["model"], made["version"], tmp_path / "wgan")
    found = bundle.sample(picture, 20, 1, start=tuple(start), goal=tuple(goal))
    assert WORLD.space.contains(found.samples).all()
    assert found.unseen.shape == (20,)
