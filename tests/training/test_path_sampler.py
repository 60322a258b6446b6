"""From a bundle with a head to a path sampler that is registered, served, and used by the planner."""

import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from cspace.bundle import Bundle
from cspace.errors import BundleError, InputError
from cspace.query import SampleQuery
from cspace.simulator import Split
from cspace.worlds import simulator_of
from cspace.worlds.planar.arm import THREE_LINK, JointLimits, PlanarArm
from cspace.worlds.planar.problems import Family, draw_problem
from inference_api.settings import PRETRAINED_FOLDER
from services.planner.planning import SampleRequest, plan
from services.planner.result import PlannerSettings
from services.planner.samples import LocalSampler, SamplingClient
from tests.bundles import holds, picture, write_tiny_bundle
from tests.contracts.mlflow_server import mlflow_server
from tests.contracts.mlflow_warnings import MLFLOW_WARNINGS
from tests.inference_api.server import api_server
from training.path_sampler import main, make_path_bundle

START, GOAL = (0.5, 0.5), (-0.5, -1.0)


@pytest.fixture(scope="module")
def source(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_tiny_bundle(tmp_path_factory.mktemp("source") / "bundle", validity=True)


@pytest.mark.slow
def test_a_path_bundle_keeps_what_it_sees_with_and_tells_where_it_comes_from(
    source: Path, tmp_path: Path
) -> None:
    origin = Bundle.load(source)
    made = make_path_bundle(origin, tmp_path / "paths")
    assert (made.spec.kind, made.spec.conditions) == ("path", ("start", "goal"))
    assert made.spec.provenance.config["source_digest"] == origin.digest
    assert made.spec.confidence_threshold == 0.0
    for name in ("encoder.onnx", "validity.onnx"):
        assert (made.folder / name).read_bytes() == (source / name).read_bytes()
    image = picture(1)
    one, again = (made.sample(image, 40, 7, start=START, goal=GOAL) for _ in range(2))
    assert np.array_equal(one.samples, again.samples)
    with pytest.raises(InputError):
        made.sample(image, 40, 7)


@pytest.mark.parametrize("limits", [((-3.1, 3.1), None), ((-2.9, 4.0), (-1.0, 1.0))])
def test_ways_of_a_limited_arm_end_at_its_limits_and_do_not_go_round(
    tmp_path: Path, limits: JointLimits
) -> None:
    robot = PlanarArm(joint_limits_rad=limits)
    source = write_tiny_bundle(tmp_path / "limited", robot, validity=True)
    made = make_path_bundle(Bundle.load(source), tmp_path / "paths")
    low, high = limits[0]
    start, goal = (low + 0.02, 0.0), (high - 0.02, 0.0)
    white = np.full((48, 48, 3), 255, dtype=np.uint8)
    samples = made.sample(white, 2000, 7, start=start, goal=goal).samples
    assert holds(robot.space, samples)
    found, _ = np.histogram(samples[:, 0], bins=12, range=(low, high))
    assert found.min() > 0


@pytest.mark.slow
def test_the_shipped_head_makes_a_sampler_that_a_planner_gains_by(tmp_path: Path) -> None:
    make_path_bundle(Bundle.load(PRETRAINED_FOLDER), tmp_path / "paths")
    sampler = LocalSampler(tmp_path / "paths")
    iterations = {"learned": [], "uniform": []}
    for index in range(12):
        problem = draw_problem(Family.NARROW, Split.DEMO, 21, index)
        settings = PlannerSettings(seed=index + 1, max_iterations=20_000)
        paths = SampleRequest(SampleQuery(300, index + 1, min_confidence=0.0), with_ends=True)
        learned = plan(problem, sampler, settings, paths, 0.3)
        uniform = plan(problem, sampler, settings, paths, 1.0)
        assert learned.result.solved
        assert learned.result.learned_drawn > 0 == uniform.result.learned_drawn
        iterations["learned"].append(learned.result.iterations)
        iterations["uniform"].append(uniform.result.iterations if uniform.result.solved else 20_000)
    # Measured on hundreds of problems: a quarter.
    assert np.median(iterations["learned"]) < 0.6 * np.median(iterations["uniform"])


@pytest.mark.e2e
@pytest.mark.slow
def test_a_registered_path_sampler_is_served_by_name(tmp_path: Path, monkeypatch) -> None:
    for name in ("mlflow", "api"):
        (tmp_path / name).mkdir()
    problem = draw_problem(Family.UNIFORM, Split.DEMO, 21, 0)
    with mlflow_server(tmp_path / "mlflow") as uri:
        monkeypatch.setenv("MLFLOW_TRACKING_URI", uri)
        assert main([str(PRETRAINED_FOLDER), str(tmp_path / "paths"), "--register", "challenger"]) == 0
        with (
            api_server(tmp_path / "api", {"MLFLOW_TRACKING_URI": uri}) as address,
            SamplingClient(address) as client,
        ):
            request = SampleRequest(SampleQuery(300, 3), "path-sampler@challenger", with_ends=True)
            found = plan(problem, client, PlannerSettings(), request)
    assert found.batch is not None
    assert (found.batch.model_name, found.batch.model_version) == ("path-sampler", 1)
    assert found.result.solved
    local = Bundle.load(tmp_path / "paths")
    assert found.batch.digest == local.digest


for mark in MLFLOW_WARNINGS:
    test_a_registered_path_sampler_is_served_by_name = mark(test_a_registered_path_sampler_is_served_by_name)


@pytest.mark.slow
def test_the_command_may_be_given_again_and_names_no_machine(source: Path, tmp_path: Path) -> None:
    command = [sys.executable, "-m", "training.path_sampler", str(source), "paths"]
    root = Path(__file__).parents[2]
    environment = os.environ | {"PYTHONPATH": str(root)}
    digests = set()
    for _ in range(2):
        done = subprocess.run(
            command, cwd=tmp_path, env=environment, capture_output=True, text=True, check=False, timeout=100
        )
        assert done.returncode == 0, done.stderr
        digests.add(Bundle.load(tmp_path / "paths").digest)
    assert len(digests) == 1
    recorded = Bundle.load(tmp_path / "paths").spec.provenance.command
    assert recorded == f"python -m training.path_sampler {source} paths"
    assert main([str(PRETRAINED_FOLDER), str(tmp_path / "paths")]) == 1


def test_a_bundle_without_a_head_is_refused(tmp_path: Path) -> None:
    plain = write_tiny_bundle(tmp_path / "plain")
    with pytest.raises(BundleError, match="no validity head"):
        make_path_bundle(Bundle.load(plain), tmp_path / "paths")
    assert not (tmp_path / "paths").exists()


def test_with_three_joints_ways_are_searched_for(tmp_path: Path) -> None:
    three = Bundle.load(write_tiny_bundle(tmp_path / "three", THREE_LINK, validity=True))
    made = make_path_bundle(three, tmp_path / "paths")
    assert (made.spec.model_kind, made.spec.conditions) == ("ways", ("start", "goal"))
    image = simulator_of(made.spec.world).render(draw_problem(Family.UNIFORM, Split.DEMO, 21, 0).scenario)
    found = made.sample(image, 30, 7, start=(0.5, 0.5, 0.0), goal=(-0.5, -1.0, 1.0))
    assert len(found.samples) == len(found.ways) == 30


@pytest.mark.slow
def test_samples_along_ways_of_the_arm_in_space_lead_to_a_path(tmp_path: Path) -> None:
    source = Bundle.load(PRETRAINED_FOLDER.with_name("pretrained_panda"))
    made = make_path_bundle(source, tmp_path / "paths")
    assert made.spec.plan_calibration == source.spec.plan_calibration
    sampler = LocalSampler(made.folder)
    for index in range(3):
        problem = simulator_of(made.spec.world).problem("uniform", Split.DEMO, 21, index)
        request = SampleRequest(SampleQuery(200, 1, min_confidence=0.0), with_ends=True)
        settings = PlannerSettings(planner="SampledRRTConnect", seed=1, range_rad=2.0, resolution_rad=0.02)
        found = plan(problem, sampler, settings, request, 0.3)
        assert found.result.solved
        assert found.result.learned_drawn > 0
