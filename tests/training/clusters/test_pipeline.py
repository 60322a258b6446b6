"""The whole job on a real Ray and a real MLflow server: every stage, nothing learned."""

import base64
import json
from pathlib import Path

import numpy as np
import pytest
from mlflow import MlflowClient

from cspace.bundle import Bundle
from cspace.files import encode_png
from inference_api.app import create_app
from inference_api.settings import ApiSettings
from services.names import ALIAS_CHALLENGER, EXPERIMENT, MODEL_NAME
from services.registry.models import ModelRegistry
from tests.inference_api.client import running
from tests.own_ray import run_alone
from training.data.config import DatasetConfig
from training.data.configurations import ConfigurationRecipe

pytestmark = [pytest.mark.e2e, pytest.mark.slow, pytest.mark.timeout(400)]

ROOT = Path(__file__).resolve().parents[3]
# Long enough that two trials that run at once can be told from two that do not, by clocks of whole seconds.
LOCAL_STEPS = 1200
WHITE = np.full((48, 48, 3), 255, dtype=np.uint8)


def run_job(uri, data_folder, *overrides, preset="smoke"):
    """Run the job as a user does and return its result line."""
    settings = [part for override in overrides for part in ("--set", override)]
    return submit(uri, data_folder, "--preset", preset, *settings)


def submit(uri, data_folder, *arguments, script="cluster_train.py"):
    done = run_alone(uri, data_folder, str(ROOT / "training" / script), *arguments)
    assert done.returncode == 0, done.stdout + done.stderr
    return json.loads(done.stdout.rpartition("RESULT ")[2].splitlines()[0])


def bundle_of(uri, name, number, folder):
    """The bundle of a registered version."""
    registry = ModelRegistry(uri)
    return Bundle.load(registry.download(registry.version(name, number), folder))


@pytest.fixture(scope="module")
def result(server, data_folder):
    return run_job(server, data_folder, f"local.steps={LOCAL_STEPS}", "resources.log_every_steps=200")


@pytest.fixture(scope="module")
def client(server):
    return MlflowClient(tracking_uri=server)


def test_the_two_local_trials_overlap_by_rays_own_timestamps(result):
    (first_start, first_end), (second_start, second_end) = (result["trials"][f"local-{i}"] for i in (0, 1))
    assert min(first_end, second_end) - max(first_start, second_start) >= 1.0
    assert result["trials"]["vae"][1] <= first_start + 1.0
    assert result["trials"]["global"][0] >= max(first_end, second_end) - 1.0


def test_every_trial_is_a_finished_child_of_the_job_and_wgans_share_their_metric_names(result, client):
    experiment = client.get_experiment_by_name(EXPERIMENT).experiment_id
    runs = client.search_runs([experiment], f"tags.mlflow.parentRunId = '{result['run_id']}'")
    assert {run.info.status for run in runs} == {"FINISHED"}
    names = {run.data.tags["trial"]: set(run.data.metrics) for run in runs}
    assert set(names) == {"vae", "validity", "local-0", "local-1", "global"}
    assert names["local-0"] == names["local-1"] == names["global"]
    assert {"critic_loss", "generator_loss", "wasserstein_estimate", "steps_per_s"} <= names["global"]


def test_the_parent_holds_configuration_data_pictures_and_source(result, client):
    run = client.get_run(result["run_id"])
    assert run.info.status == "FINISHED"
    assert run.data.params["local.steps"] == str(LOCAL_STEPS)
    assert run.data.tags["preset"] == "smoke"
    assert {"git.commit", "git.dirty", "seed"} <= set(run.data.tags)
    assert [entry.dataset.digest for entry in run.inputs.dataset_inputs] == [result["data_digest"][:36]]
    pictures = {Path(entry.path).stem for entry in client.list_artifacts(result["run_id"], "figures")}
    assert pictures == set(result["figures"]) == {"samples-seen", "samples-unseen"}


def test_the_bundle_is_the_challenger_with_its_lineage_and_samples(result, server, data_folder, tmp_path):
    registry = ModelRegistry(server)
    version = registry.by_alias(MODEL_NAME, ALIAS_CHALLENGER)
    assert (version.number, version.run_id) == (result["version"], result["run_id"])
    bundle = Bundle.load(registry.download(version, tmp_path / "bundle"))
    assert bundle.digest == version.digest == result["digest"]
    assert bundle.spec.provenance.data_digest == result["data_digest"]
    assert bundle.sample(WHITE, 10, 1, min_confidence=0.0).samples.shape == (10, 2)
    folder = data_folder / "jobs" / result["run_id"]
    assert json.loads((folder / "result.json").read_text()) == result
    assert Bundle.load(folder / "bundle").digest == result["digest"]


def test_an_encoder_trained_with_the_generator_makes_a_bundle_and_a_resumed_job_trains_nothing_twice(
    server, data_folder, tmp_path
):
    settings = (*(f"global.{part}=16" for part in ("hidden", "critic_hidden")), "global.steps=8",
                "vae.latent_dim=8", "data.scenario_count=24", "data.free_per_scenario=64")  # fmt: skip
    first = run_job(server, data_folder, *settings, preset="paper_joint")
    assert set(first["trials"]) == {"global"}
    assert {"reconstruction_loss", "kl", "generator_loss"} <= set(first["metrics"])
    again = submit(server, data_folder, "--resume", first["run_id"])
    assert (again["run_id"], again["trials"]) == (first["run_id"], first["trials"])
    one, other = (
        bundle_of(server, MODEL_NAME, result["version"], tmp_path / name)
        for name, result in (("first", first), ("again", again))
    )
    assert np.array_equal(*(each.sample(WHITE, 20, 1, min_confidence=0.0).samples for each in (one, other)))


def test_a_three_link_arm_runs_through_the_same_job(server, data_folder, tmp_path):
    links = "data.robot.link_lengths_m=[1.6, 1.4, 1.0]"
    result = run_job(server, data_folder, links, "clusters.count=3", "global.local_critic_weight=0")
    assert set(result["trials"]) == {"vae", "validity", "local-0", "local-1", "local-2", "global"}
    assert result["model"] == "three-link-sampler"
    bundle = bundle_of(server, result["model"], result["version"], tmp_path / "bundle")
    settings = ApiSettings(registry_uri=None, model_cache=tmp_path / "cache", pretrained_model=bundle.folder)
    with running(create_app(settings, None)) as client:
        body = {"image": base64.b64encode(encode_png(WHITE)).decode(), "n": 7, "min_confidence": 0}
        answer = client.post("/sample", json=body)
    assert np.shape(answer.json()["samples"]) == (7, 3)


def test_the_same_seed_trains_the_same_sampler(result, server, data_folder, tmp_path):
    again = run_job(server, data_folder, f"local.steps={LOCAL_STEPS}", "resources.log_every_steps=200")
    assert again["version"] > result["version"]
    numbers = [result["version"], again["version"]]
    bundles = [bundle_of(server, MODEL_NAME, number, tmp_path / str(number)) for number in numbers]
    first, second = (bundle.sample(WHITE, 50, 3, min_confidence=0.0).samples for bundle in bundles)
    np.testing.assert_array_equal(first, second)


def test_a_mixture_is_trained_on_a_data_set_of_ones_own(server, data_folder, tmp_path):
    config = DatasetConfig(
        scenario_count=24, free_per_scenario=64, collision_per_scenario=16, extra_image_count=4
    )
    recipe = ConfigurationRecipe(config)
    own = recipe.write(tmp_path / "own", recipe.make)
    made = run_job(server, data_folder, f"data_folder={own.folder}", preset="smoke_mixture")
    assert made["data_digest"] == own.digest
    assert set(made["trials"]) == {"vae", "validity", "gate", "local-0", "local-1"}
    bundle = bundle_of(server, MODEL_NAME, made["version"], tmp_path / "bundle")
    assert bundle.spec.looks_at_picture
    assert bundle.sample(WHITE, 9, 1, min_confidence=0.0).samples.shape == (9, 2)
