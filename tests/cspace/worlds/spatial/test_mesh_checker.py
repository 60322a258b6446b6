from dataclasses import replace
from importlib.metadata import files
from math import pi
from pathlib import Path

import numpy as np
import pytest

from cspace.simulator import Split
from cspace.worlds.spatial.arm import Joint, Part, SerialArm
from cspace.worlds.spatial.benchmark import problems
from cspace.worlds.spatial.collision import CollisionChecker
from cspace.worlds.spatial.mesh_checker import RobotMeshes
from cspace.worlds.spatial.obstacles import Box, Cylinder, Obstacles
from cspace.worlds.spatial.poses import Frame, pose_of
from tests.cspace.worlds.spatial.test_robots import PANDA, UR5
from tests.training.robots.descriptions import described

# The arm of `described`; its spheres are not asked.
TWO = SerialArm(
    "two",
    (
        Joint("shoulder", Frame((0.0, 0.0, 0.1)), (0.0, 1.0, 0.0), (-2.0, 2.0)),
        Joint("elbow", Frame((0.0, 0.0, 0.5), (0.0, 0.0, pi / 2)), (1.0, 0.0, 0.0), None),
    ),
    tuple(
        Part(name, link, ((0.0, 0.0, 0.0, 0.01),))
        for name, link in (("base", 0), ("upper", 1), ("lower", 2), ("gripper", 2))
    ),
    (("base", "gripper"), ("upper", "gripper")),
    Frame((0.0, 0.0, 0.3)),
)
REASON = "needs the extra spatial"


@pytest.fixture
def meshes(tmp_path: Path) -> RobotMeshes:
    pytest.importorskip("coal", reason=REASON)
    pytest.importorskip("pinocchio", reason=REASON)
    return RobotMeshes(TWO, described(tmp_path))


def block(x: float, z: float, half: float) -> Box:
    pose = np.eye(4)
    pose[:3, 3] = (x, 0.0, z)
    return Box(pose_of(pose), (half, half, half))


def test_an_arm_is_free_up_to_the_surface_of_a_shape(meshes: RobotMeshes) -> None:
    # Beside the upper arm of radius 0.05, and beside the lower one, whose 0.06 lie along x.
    turned = np.diag([1.0, -1.0, -1.0, 1.0])
    for obstacle, is_free in (
        (block(0.151, 0.35, 0.1), True),
        (block(0.149, 0.35, 0.1), False),
        (block(-0.081, 0.75, 0.05), True),
        (block(-0.079, 0.75, 0.05), False),
        (Cylinder(pose_of(turned + np.eye(4, k=3) * 0.151), 0.1, 2.0), True),
        (Cylinder(pose_of(turned + np.eye(4, k=3) * 0.149), 0.1, 2.0), False),
    ):
        assert meshes.among(Obstacles.of([obstacle])).valid_batch([[0.0, 0.0]])[0] == is_free


def test_pairs_that_can_touch_are_held_apart(tmp_path: Path, meshes: RobotMeshes) -> None:
    folded = [[0.0, 0.0], [0.0, pi], [0.0, -pi]]
    assert meshes.among(Obstacles()).valid_batch(folded).tolist() == [True, False, False]
    loose = SerialArm(TWO.name, TWO.joints, TWO.parts, (), TWO.tool)
    checker = RobotMeshes(loose, described(tmp_path)).among(Obstacles())
    assert checker.valid_batch(folded).all()


def published(urdf: str) -> Path:
    pytest.importorskip("pinocchio", reason=REASON)
    listed = files("example-robot-data") or []
    return next(Path(one.locate()) for one in listed if str(one).endswith(urdf))


@pytest.fixture(scope="module")
def panda() -> RobotMeshes:
    fingers = {f"panda_finger_joint{number}": 0.065 for number in (1, 2)}
    return RobotMeshes(PANDA, published("panda_description/urdf/panda.urdf"), fingers)


@pytest.fixture(scope="module")
def ur5() -> RobotMeshes:
    # A box of 1 cm at the flange: meshes are checked by their surfaces, which it does not touch inside them.
    pairs = tuple(pair for pair in UR5.touching if "ee_link" not in pair)
    urdf = published("ur_description/urdf/ur5_joint_limited_robot.urdf")
    return RobotMeshes(replace(UR5, touching=pairs), urdf)


@pytest.mark.parametrize("robot", ["panda", "ur5"])
def test_arms_touch_themselves_where_their_meshes_do(robot: str, request: pytest.FixtureRequest) -> None:
    meshes: RobotMeshes = request.getfixturevalue(robot)
    space = meshes.arm.space
    rows = np.random.default_rng(0).uniform(space.lower, space.upper, (3000, space.dim))
    free = meshes.among(Obstacles()).valid_batch(rows)
    clear = CollisionChecker(meshes.arm, Obstacles()).valid_batch(rows)
    assert 0.02 < np.mean(~free) < 0.5
    assert np.mean(free & ~clear) <= 0.01
    assert np.mean(~free & clear) <= 0.005


def test_all_ends_of_the_pandas_problems_are_free_by_its_meshes(panda: RobotMeshes) -> None:
    folded = [0.0, 0.0, 0.0, -3.1, 0.0, 0.0, 0.0]
    for problem in problems(Split.VALIDATION):
        found = panda.among(problem.obstacles).valid_batch([problem.start, problem.goal, folded])
        assert found.tolist() == [True, True, False]


def test_a_collision_that_coal_misses_without_contacts_is_told(panda: RobotMeshes) -> None:
    problem = problems(Split.VALIDATION, families=("cage",))[16]
    row = [[-2.9671, 0.102454, 2.756017, -1.950074, 2.367983, 2.934542, -2.209954]]
    assert not panda.among(problem.obstacles).valid_batch(row)[0]
