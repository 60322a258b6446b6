"""An arm in space from the preset to a version that answers: every stage runs, nothing is learned."""

import json

import numpy as np
import pytest
from mlflow import MlflowClient

from cspace.dataset import ATTRIBUTES, open_dataset
from cspace.simulator import Split, scenario_rng
from cspace.view_file import unpack_view
from cspace.worlds import checker_of, examples, picture_file_of, robot_digest, simulator_of
from services.outcomes import Spool, upload, view_row
from services.registry.tracking import Tracking
from tests.training.clusters.test_pipeline import bundle_of, submit
from training.data.__main__ import main as datasets
from training.data.outcomes import known_plans

pytestmark = [pytest.mark.e2e, pytest.mark.slow, pytest.mark.timeout(600)]

WORLD = examples()["panda"]
SMALL = (
    *("data.scenario_count=6", "data.proposals_per_scenario=80", "data.shard_size=3"),
    *("vae.latent_dim=8", "vae.width=4", "vae.steps=4", "vae.batch_size=4"),
    *(
        "validity.scene_model=null",
        "validity.steps=4",
        "validity.pictures_per_step=2",
        "validity.configurations_per_picture=8",
    ),
    *("validity.hidden=8", "validity.grid={width: 4, middle: 4, deep: 4}"),
    *("validity.threshold=0.05", "validity.promise={scenarios: 30}"),
    "validity.plan_problems=7",
    *("gate.cells=4", "gate.points=64", "gate.steps=4"),
    *("local.hidden=16", "local.critic_hidden=16", "local.batch_size=32", "local.steps=4"),
)


@pytest.fixture(scope="module")
def trained(tmp_path_factory, server):
    """What the job says, the registry's bundle, and the folder of its data sets."""
    folder = tmp_path_factory.mktemp("space")
    settings = [part for setting in SMALL for part in ("--set", setting)]
    result = submit(server, folder, "--preset", "panda_quick", *settings)
    return result, bundle_of(server, result["model"], result["version"], folder / "bundle"), folder


def test_the_model_is_the_arms_own_and_states_what_was_measured_of_it(trained):
    result, bundle, *_ = trained
    spec, metrics = bundle.spec, bundle.spec.provenance.metrics
    assert result["model"] == "panda-sampler"
    assert spec.world == WORLD
    assert spec.provenance.config["preset"] == "panda_quick"
    assert {"vae", "validity", "gate", "local-0", "local-1"} <= set(result["trials"])
    for kind in ("samples", "uniform"):
        one = {name.rpartition("/")[2]: value for name, value in metrics.items() if f"/{kind}_" in name}
        assert (one["scenes"], one["measured_scenes"]) == (10.0, 10.0)
        assert 1.0 / 11.0 <= one["at_most"] <= 1.0
        assert 0.0 <= one["measured"] <= 1.0
    assert metrics["plans/fitted"] == 7.0
    assert 0.0 <= metrics["plans/collide"] <= 1.0
    assert spec.plan_calibration is not None
    assert min(slope for _, slope in spec.plan_calibration) > 0.0


def test_its_data_are_labelled_configurations_of_arrays_of_space(trained):
    (manifest,) = trained[2].glob("datasets/*/*.json")
    dataset = open_dataset(manifest.parent)
    assert dataset.images.shape == (6, *WORLD.sensor.picture_shape)
    assert len(dataset.free) + len(dataset.collision) == 6 * 80
    assert len(ATTRIBUTES.keys() & dataset.arrays.keys()) == 4


def test_samples_lie_within_the_limits_and_tell_what_no_camera_saw(trained):
    bundle = trained[1]
    scene = simulator_of(WORLD).scene(scenario_rng(Split.DEMO, 0, 0), Split.DEMO, 0)
    picture = bundle.prepare(WORLD.read_picture(simulator_of(WORLD).picture_file(scene)))
    found = bundle.sample(picture, 300, 1, min_confidence=0.0)
    assert WORLD.space.contains(found.samples).all()
    assert found.confidence.shape == found.unseen.shape == (300,)
    assert np.ptp(found.unseen) > 0.0
    assert 0.0 <= picture.novelty <= 1.0


def recordings(folder, count=5):
    """Scenes as somebody records them: pictures, cameras, where the arm was, what was free and what not."""
    folder.mkdir()
    for index in range(count):
        scene = simulator_of(WORLD).scene(scenario_rng(Split.DEMO, 1, index), Split.DEMO, index)
        view = unpack_view(picture_file_of(scene))
        names = [f"scene-{index}-{number}.png" for number in range(len(view.pictures))]
        for name, picture in zip(names, view.pictures, strict=True):
            (folder / name).write_bytes(picture)
        values = {"pictures": names, "cameras": view.cameras, "state": view.state}
        (folder / f"scene-{index}.json").write_text(json.dumps(values))
        rows = WORLD.space.sample_uniform(np.random.default_rng(index), 80)
        free = checker_of(scene).valid_batch(rows)
        np.save(folder / f"scene-{index}.npy", rows[free])
        np.save(folder / f"scene-{index}.collision.npy", rows[~free])
    return folder


def test_what_became_of_plans_trains_the_scene_model_further(server, tmp_path, monkeypatch):
    """With the preset panda_outcomes: import-outcomes --arm panda, and data.outcomes."""
    rows = []
    for index in range(6):
        scene = simulator_of(WORLD).scene(scenario_rng(Split.DEMO, 2, index), Split.DEMO, index)
        path = WORLD.space.sample_uniform(np.random.default_rng(index), 2)
        asked = {"request_id": f"r{index}", "client": None}
        rows.append(
            asked | view_row("panda-sampler/1", robot_digest(WORLD), picture_file_of(scene), path, 1e6)
        )
        ended = {"success": False, "collided": True, "collided_at": 0.5} if index % 2 else {"success": True}
        rows.append(asked | {"kind": "plan", "model": "panda-sampler/1"} | ended)
    spool, data = tmp_path / "spool", tmp_path / "outcomes"
    kept = Spool(spool, 2**28, lambda *_: None)
    assert all(kept.add([row]) for row in rows)
    monkeypatch.setenv("MLFLOW_TRACKING_URI", server)
    assert len(list(upload(spool, Tracking(server)))) == 1
    assert datasets(["import-outcomes", str(data), "--arm", "panda"]) == 0
    there = open_dataset(data)
    assert there.scenario_count == sum(
        not one.held_out for one in known_plans(Tracking(server), robot_digest(WORLD))
    )
    without_size = [
        part
        for part in SMALL
        if not part.startswith(("validity.scene_model", "validity.grid", "validity.hidden"))
    ]
    settings = [part for setting in (*without_size, f"data.outcomes={data}") for part in ("--set", setting)]
    result = submit(server, tmp_path / "jobs", "--preset", "panda_outcomes", *settings)
    assert "validity" in result["trials"]
    bundle = bundle_of(server, result["model"], result["version"], tmp_path / "bundle")
    assert bundle._graphs.field is not None
    (generated,) = (tmp_path / "jobs").glob("datasets/*/*.json")
    assert "outcomes" not in open_dataset(generated.parent).manifest.generator
    inputs = MlflowClient(server).get_run(result["run_id"]).inputs.dataset_inputs
    assert {one.dataset.name for one in inputs} == {generated.parent.name, "outcomes"}


def test_recordings_of_ones_own_train_a_version_that_promises_nothing(server, tmp_path):
    source, data = recordings(tmp_path / "own"), tmp_path / "data"
    assert datasets(["import", str(source), str(data), "--arm", "panda"]) == 0
    # With the shipped scene model no head is trained.
    kept = [part for part in SMALL if not part.startswith(("data.", "validity.scene_model"))]
    settings = [part for setting in (*kept, f"data_folder={data}") for part in ("--set", setting)]
    result = submit(server, tmp_path / "jobs", "--preset", "panda_quick", *settings)
    bundle = bundle_of(server, result["model"], result["version"], tmp_path / "bundle")
    assert bundle.spec.world.body == WORLD.body
    assert bundle.spec.world.scenes is None
    assert bundle.spec.provenance.metrics == {}
    assert set(result["trials"]) == {"vae", "gate", "local-0", "local-1"}
    assert bundle.spec.provenance.config["validity"]["scene_model"] == "shipped"
