"""Scene files: what they say, and the line that is wrong."""

import json
from pathlib import Path

import numpy as np
import pytest
from jsonschema import Draft202012Validator

from cspace.errors import SamplerModelError, ScenarioError
from cspace.query import SampleQuery
from cspace.simulator import OWN
from cspace.worlds.planar.arm import PlanarArm
from cspace.worlds.planar.camera import Camera
from cspace.worlds.planar.world import Disc, DiscScenes, GivenScenes, PlanarWorld, Scenario
from services.planner.__main__ import main
from services.planner.planning import SampleRequest, plan
from services.planner.result import PlannerSettings
from services.planner.samples import SampleBatch
from services.scene_files import given_scenes, read_scene_file, schema

WHOLE = """\
name: bench-arm
robot:
  link_lengths_m: [1.6, 1.4]
  half_width_m: 0.05
  joint_limits_rad: [null, [-2.5, 2.5]]
camera: {x_min_m: -4, x_max_m: 4, y_min_m: -4, y_max_m: 4, pixels: 32}
scenes: {count: [5, 5], radius_m: [0.4, 0.4]}
obstacles:
  - {shape: disc, x_m: 1.5, y_m: 2, radius_m: 0.4}
  - {x_m: -1.5, y_m: 2}
start: [0, 0.4]
goal: [-1.8, -0.5]
"""
ARM = PlanarArm((1.6, 1.4), 0.05, (None, (-2.5, 2.5)))
CAMERA = Camera(-4.0, 4.0, -4.0, 4.0, 32)


@pytest.fixture
def write(tmp_path: Path):
    def write(text: str, name: str = "scene.yaml") -> Path:
        path = tmp_path / name
        path.write_text(text)
        return path

    return write


def test_a_file_holds_robot_camera_family_obstacles_and_ends(write):
    found = read_scene_file(write(WHOLE))
    assert found.name == "bench-arm"
    assert found.world == PlanarWorld(ARM, CAMERA, DiscScenes((5, 5), (0.4, 0.4)))
    assert found.scene == Scenario(ARM, (Disc(1.5, 2.0, 0.4), Disc(-1.5, 2.0, 1.0)), CAMERA)
    problem = found.problem()
    assert (problem.family, problem.start.tolist(), problem.goal.tolist()) == (OWN, [0.0, 0.4], [-1.8, -0.5])


def test_json_says_the_same_as_yaml(write):
    values = {"robot": {"link_lengths_m": [2, 2]}, "obstacles": [{"x_m": 1, "y_m": 1}]}
    found = read_scene_file(write(json.dumps(values), "scene.json"))
    assert found.world == PlanarWorld()
    assert found.scene == Scenario(PlanarArm(), (Disc(1.0, 1.0),))
    assert (found.start, found.goal) == (None, None)


def test_the_schema_is_one_and_takes_what_is_read():
    Draft202012Validator.check_schema(schema())
    assert Draft202012Validator(schema()).is_valid({"robot": {"link_lengths_m": [1.0]}})
    for robot in ({"link_lengths_m": []}, {"link_lengths_m": [1.0] * 65}, {}):
        assert not Draft202012Validator(schema()).is_valid({"robot": robot})


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("robot:", "robt:", "robt is unknown"),
        ("y_m: 2, radius_m: 0.4}", "y_m: 2, radius_m: -1}", r"obstacles\.0\.radius_m.*greater than 0"),
        ("[1.6, 1.4]", "[1.6, long]", r"link_lengths_m\.1"),
        ("[-2.5, 2.5]]", "[2.5, -2.5]]", "joint limits"),
        ("radius_m: [0.4, 0.4]", "radius_m: [9, 9]", "family of scenes"),
        ("goal: [-1.8, -0.5]", "goal: [-103, -0.5]", "goal lies outside.*joint 1 at -103 rad.*degrees"),
        ("goal: [-1.8, -0.5]", "goal: [-1.8]", "2 angles"),
        ("[1.6, 1.4]", "[1.6, 1e200]", r"link_lengths_m\.1.*equal to 1000000"),
        ("name: bench-arm", "world: hyperbolic", "the world is unknown"),
    ],
)
def test_what_does_not_fit_is_told_with_its_place(write, old, new, words):
    assert old in WHOLE
    path = write(WHOLE.replace(old, new))
    with pytest.raises(ScenarioError, match=rf"(?s){path}.*{words}"):
        read_scene_file(path)


@pytest.mark.parametrize("text", ["", "[]", "robot", "a: &a [*a]", "{" * 200, "\x00"])
def test_what_is_no_scene_file_is_refused(write, text):
    with pytest.raises(ScenarioError):
        read_scene_file(write(text))


def test_the_command_refuses_a_file_of_aliases_before_it_fills_the_memory(write, capsys):
    levels = ["a0: &a0 [1, 1]", *(f"a{n}: &a{n} [{', '.join([f'*a{n - 1}'] * 10)}]" for n in range(1, 9))]
    assert main(["plan", str(write("\n".join(levels))), "--api", "http://127.0.0.1:1"]) == 2
    assert "scene.yaml is no YAML" in capsys.readouterr().err


def test_a_file_without_end_is_refused():
    with pytest.raises(ScenarioError, match="too large"):
        read_scene_file(Path("/dev/zero"))


def test_scenes_of_files_are_those_of_a_world_and_some_are_held_out(write):
    files = [
        read_scene_file(write(WHOLE.replace("x_m: 1.5", f"x_m: {number}"), f"{number}.yaml"))
        for number in range(1, 8)
    ]
    given = given_scenes(files[0].world, files)
    assert (len(given.train), len(given.held_out)) == (6, 1)
    assert given.held_out[0][0] == (5.0, 2.0, 0.4)
    assert isinstance(given, GivenScenes)
    other = read_scene_file(write(WHOLE.replace("1.6", "1.7"), "other.yaml"))
    with pytest.raises(ScenarioError, match=r"other\.yaml has another robot"):
        given_scenes(files[0].world, [*files, other])


def test_the_command_plans_in_a_file(write, tmp_path, capsys):
    figure = tmp_path / "plan.png"
    away = ("--api", "http://127.0.0.1:1", "--plot", str(figure))
    assert main(["plan", str(write(WHOLE)), *away]) == 0
    shown = capsys.readouterr().out
    assert "your own, 2 joints" in shown
    assert figure.stat().st_size > 10_000


def test_a_problem_without_a_solution_is_told_at_once(write, capsys):
    blocked = WHOLE.replace("goal: [-1.8, -0.5]", "goal: [0.93, 0]")
    assert main(["plan", str(write(blocked))]) == 1
    assert "the goal is" in capsys.readouterr().err
    ring = "".join(
        f"  - {{x_m: {3 * np.cos(a):.3f}, y_m: {3 * np.sin(a):.3f}, radius_m: 0.5}}\n" for a in (1, -1)
    )
    apart = WHOLE[: WHOLE.index("  - {shape")] + ring + "start: [0, 0]\ngoal: [3.1, 0]\n"
    limits = apart.replace("[null, [-2.5, 2.5]]", "[[-3.14, 3.14], [-0.1, 0.1]]")
    assert main(["plan", str(write(limits))]) == 1
    assert "apart" in capsys.readouterr().err


class _Source:
    """Has one model."""

    def __init__(self, model: str) -> None:
        self.model, self.models = model, []

    def answer(self, picture, query, model=None):
        self.models.append(model)
        if model != self.model:
            raise SamplerModelError("the sampling endpoint refused the request: No such model")
        samples = np.tile(np.array([[-1.0, 0.5]], dtype=np.float32), (query.n, 1))
        return SampleBatch(samples, model, 1, "0" * 64, query.seed, 0, 0.0)


def test_a_scene_file_s_robot_has_its_own_model_and_goes_without_where_there_is_none(write):
    scene = read_scene_file(write(WHOLE))
    request = SampleRequest(SampleQuery(3, 0)).of_robot(scene.world, scene.name)
    assert (request.model, request.or_uniform) == ("bench-arm-sampler", True)
    there, away = _Source("bench-arm-sampler"), _Source("cspace-sampler")
    assert plan(scene.problem(), there, PlannerSettings(), request).batch is not None
    found = plan(scene.problem(), away, PlannerSettings(), request)
    assert found.unavailable == "there is no bench-arm-sampler yet"
    assert found.result.solved


def test_a_model_that_the_user_names_has_to_be_there(write):
    scene = read_scene_file(write(WHOLE))
    request = SampleRequest(SampleQuery(3, 0), "bench-sampler").of_robot(scene.world, scene.name)
    with pytest.raises(SamplerModelError):
        plan(scene.problem(), _Source("bench-arm-sampler"), PlannerSettings(), request)


def test_the_default_robot_s_model_is_left_to_the_api(write):
    values = {"robot": {"link_lengths_m": [2, 2]}, "obstacles": [], "start": [0, 0], "goal": [1, 1]}
    scene = read_scene_file(write(json.dumps(values), "scene.json"))
    assert SampleRequest(SampleQuery(3, 0)).of_robot(scene.world, scene.name).model is None


def test_an_end_that_rounding_moved_beyond_a_limit_is_taken_as_the_limit(write):
    found = read_scene_file(write(WHOLE.replace("start: [0, 0.4]", "start: [0, 2.5000000001]")))
    assert found.start.tolist() == [0.0, 2.5]
