"""Robots that nobody planned for: each works from its file to a plan, or is refused with a reason."""

import json
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from cspace.errors import DatasetError, ScenarioError
from cspace.simulator import Split
from cspace.worlds import read_world, simulator_of
from cspace.worlds.planar.world import DiscScenes
from services.planner.ompl_planner import solve
from services.planner.result import PlannerSettings
from services.scene_files import SceneFile, read_scene_file
from tests.bundles import holds
from tests.own_ray import run_alone
from tests.training.clusters.test_pipeline import bundle_of
from training.data.configurations import sample_configurations

ROOT = Path(__file__).resolve().parents[2]


@st.composite
def robot_files(draw: st.DrawFn) -> dict[str, object]:
    """Arms of one to four links of any size and limits, in families of their scale, some impossible."""
    scale_m = draw(st.sampled_from([0.05, 1.0, 20.0]))
    links = draw(st.lists(st.floats(0.1, 2.0), min_size=1, max_size=4))
    limit = st.tuples(st.floats(-7.0, 7.0), st.floats(-7.0, 7.0)).map(list)
    limits = st.lists(st.none() | limit, min_size=len(links), max_size=len(links))
    reach_m = scale_m * sum(links)
    low, high = sorted(draw(st.tuples(st.floats(0.02, 0.4), st.floats(0.02, 0.4))))
    side_m = 1.3 * reach_m
    return {
        "robot": {
            "link_lengths_m": [scale_m * link for link in links],
            "half_width_m": scale_m * draw(st.floats(0.01, 0.2)),
            "joint_limits_rad": draw(st.none() | limits),
        },
        "camera": {"x_min_m": -side_m, "x_max_m": side_m, "y_min_m": -side_m, "y_max_m": side_m},
        "scenes": {
            "count": sorted(draw(st.tuples(st.integers(1, 6), st.integers(1, 6)))),
            "radius_m": [low * reach_m, high * reach_m],
            "range_m": reach_m,
            "base_clearance_m": 0.2 * scale_m,
        },
    }


@settings(max_examples=25, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(values=robot_files(), seed=st.integers(0, 2**32 - 1))
@pytest.mark.slow
def test_any_robot_has_scenes_pictures_data_and_plans_or_a_reason(tmp_path, values, seed) -> None:
    path = tmp_path / "robot.json"
    path.write_text(json.dumps(values))
    try:
        world = read_scene_file(path).world
    except ScenarioError as error:
        assert f"{path}:" in str(error)  # noqa: PT017 - one of two good ends
        return
    assert read_world(json.loads(json.dumps(world.to_dict()))) == world
    simulator, rng = simulator_of(world), np.random.default_rng(seed)
    scene = simulator.scene(rng, Split.TRAIN, 0)
    assert simulator.render(scene).shape == world.sensor.picture_shape
    checker = simulator.checker(scene)
    try:
        free = sample_configurations(checker, 20, rng, free=True)
    except DatasetError as error:
        assert "hardly any configuration" in str(error)  # noqa: PT017 - likewise
        return
    assert world.space.contains(free).all()
    assert checker.valid_batch(free).all()
    problem = SceneFile(path, None, world, scene, free[0], free[1]).problem()
    result = solve(problem, PlannerSettings(max_iterations=2000, time_limit_s=2.0))
    if simulator.obstruction(problem) is not None:
        assert not result.solved
    if result.solved:
        assert checker.valid_batch(result.path).all()


ARMS = {
    "one": {"link_lengths_m": [2.5], "half_width_m": 0.2},
    "four": {"link_lengths_m": [1.0, 0.8, 0.7, 0.6], "half_width_m": 0.05},
}
FAMILY = {"count": [5, 5], "radius_m": [0.4, 0.4], "range_m": 3.0}


def run(uri: str, data: Path, *command: str) -> str:
    done = run_alone(uri, data, *command)
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


@pytest.mark.e2e
@pytest.mark.slow
@pytest.mark.timeout(600)
@pytest.mark.parametrize("name", ARMS)
def test_an_own_robot_goes_from_its_file_to_a_version_and_a_verdict(name, server, tmp_path) -> None:
    robot, data = tmp_path / "robot.json", tmp_path / "data"
    robot.write_text(json.dumps({"name": f"arm-{name}", "robot": ARMS[name], "scenes": FAMILY}))
    counts = ("--scenario-count", "24", "--extra-image-count", "24", "--free-per-scenario", "64")
    run(server, tmp_path, "-m", "training.data", "generate", str(data), "--robot", str(robot), *counts)
    settings = ("--preset", "smoke", "--set", f"data_folder={data}")
    output = run(server, tmp_path, str(ROOT / "training" / "cluster_train.py"), *settings)
    result = json.loads(output.rpartition("RESULT ")[2].splitlines()[0])
    bundle = bundle_of(server, result["model"], result["version"], tmp_path / "bundle")
    assert bundle.spec.world == read_scene_file(robot).world
    assert bundle.spec.world.scenes == DiscScenes(**{key: _tuple(value) for key, value in FAMILY.items()})
    picture = np.full((48, 48, 3), 255, dtype=np.uint8)
    samples = bundle.sample(picture, 200, 1).samples
    assert holds(bundle.spec.world.space, samples)
    judged = ("-m", "services.evaluator", "--model", f"{result['model']}/{result['version']}")
    few = run(server, tmp_path, *judged, "--scenarios", "4")
    assert "promoted" in few


def _tuple(value: object) -> object:
    return tuple(value) if isinstance(value, list) else value
