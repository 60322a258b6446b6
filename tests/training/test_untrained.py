"""python -m training.untrained: a model of an arm that nobody trained for it."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from cspace.bundle import Bundle, graphs_of, write_bundle
from cspace.query import SampleQuery
from cspace.simulator import Split
from cspace.worlds import picture_file_of, robot_digest, simulator_of
from cspace.worlds.spatial.collision import CollisionChecker
from cspace.worlds.spatial.obstacles import Obstacles
from cspace.worlds.spatial.world import shipped, usual
from services.planner.samples import SamplingClient
from tests.bundles import holds
from tests.contracts.mlflow_server import mlflow_server
from tests.contracts.mlflow_warnings import MLFLOW_WARNINGS
from tests.inference_api.server import api_server
from training.config import GridConfig
from training.models.checkpoint import save_scene_model, seeded_initialisation
from training.models.grid_head import SceneModel
from training.untrained import main

ARM = replace(shipped("ur5"), name="bench-arm")
WORLD = usual(ARM)


@pytest.fixture
def robot(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A robot's file, and a small scene model that has learned nothing."""
    sizes = GridConfig(width=4, middle=4, deep=4)
    with seeded_initialisation(0):
        model = SceneModel(sizes, 8, WORLD.grid_arm(sizes.groups))
    save_scene_model(tmp_path / "model.safetensors", model)
    monkeypatch.setattr("training.clusters.bundling.THRESHOLD_SCENARIOS", 2)
    path = tmp_path / "bench.json"
    path.write_text(json.dumps(ARM.to_dict()))
    return path


def make(robot: Path, folder: Path, *more: str) -> int:
    small = ["--scene-model", str(robot.with_name("model.safetensors")), "--plan-problems", "0"]
    return main([str(robot), str(folder), *small, *more])


@pytest.mark.slow
def test_samples_are_uniform_and_kept_by_the_head(robot: Path, tmp_path: Path) -> None:
    folder = tmp_path / "bundle"
    assert make(robot, folder) == 0
    bundle = Bundle.load(folder)
    assert robot_digest(bundle.spec.world) == robot_digest(WORLD)
    problem = simulator_of(WORLD).problem("table", Split.VALIDATION, 0, 0)
    picture = bundle.prepare(simulator_of(WORLD).render(problem.scenario))
    drawn = bundle.sample(picture, 4000, 1, min_confidence=0.0).samples
    assert holds(WORLD.space, drawn)
    shares = (drawn - np.array(WORLD.space.lower)) / np.subtract(WORLD.space.upper, WORLD.space.lower)
    for column in shares.T:
        counts, _ = np.histogram(column, bins=8, range=(0.0, 1.0))
        # Six standard deviations of what falls in an eighth.
        assert np.abs(counts - 500).max() < 6.0 * 21.0
    alone = CollisionChecker(ARM, Obstacles())
    assert not alone.valid_batch(drawn).all()
    kept = bundle.sample(picture, 300, 1, min_confidence=0.01).samples
    assert len(kept) > 50
    assert alone.valid_batch(kept).all()
    assert make(robot, folder) == 0
    assert Bundle.load(folder).digest == bundle.digest
    # A folder that more plans calibrated is taken as it is.
    made = bundle.spec.provenance
    more = replace(made, config={**made.config, "plan_problems": 2})
    calibrated = write_bundle(tmp_path / "more", replace(bundle.spec, provenance=more), graphs_of(folder))
    digest = Bundle.load(calibrated).digest
    assert make(robot, calibrated, "--plan-problems", "1") == 0
    assert Bundle.load(calibrated).digest == digest
    # Another arm's may not take its place.
    robot.write_text(json.dumps(replace(ARM, name="other-arm").to_dict()))
    assert make(robot, folder) == 1
    assert Bundle.load(folder).digest == bundle.digest


@pytest.mark.e2e
@pytest.mark.slow
def test_an_arm_is_served_by_its_name_without_training(robot: Path, tmp_path: Path, monkeypatch) -> None:
    for name in ("mlflow", "api"):
        (tmp_path / name).mkdir()
    with mlflow_server(tmp_path / "mlflow") as uri:
        monkeypatch.setenv("MLFLOW_TRACKING_URI", uri)
        for _ in range(2):
            assert make(robot, tmp_path / "bundle", "--register", "champion") == 0
        with (
            api_server(tmp_path / "api", {"MLFLOW_TRACKING_URI": uri}) as address,
            SamplingClient(address, robot=robot_digest(WORLD)) as client,
        ):
            scene = simulator_of(WORLD).problem("table", Split.VALIDATION, 0, 0).scenario
            query = SampleQuery(50, 1)
            batch = client.answer(picture_file_of(scene), query, "bench-arm-sampler")
    assert (batch.model_name, batch.model_version) == ("bench-arm-sampler", 1)
    assert batch.digest == Bundle.load(tmp_path / "bundle").digest


for mark in MLFLOW_WARNINGS:
    test_an_arm_is_served_by_its_name_without_training = mark(
        test_an_arm_is_served_by_its_name_without_training
    )


def test_a_robot_that_is_none_is_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["pandora", str(tmp_path / "bundle")]) == 2
    assert "pandora" in capsys.readouterr().err
    assert not (tmp_path / "bundle").exists()
