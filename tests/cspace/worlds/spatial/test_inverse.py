"""Inverse kinematics, held against forward kinematics."""

import numpy as np
import pytest

from cspace.worlds.spatial.arm import Joint, SerialArm
from cspace.worlds.spatial.kinematics import Solving, solve_pose
from cspace.worlds.spatial.poses import Frame
from tests.cspace.worlds.spatial.test_robots import PANDA

PLACE_M, TURN_RAD = 1e-3, np.radians(1.0)
# Two links of 1 m in the plane z = 0, both joints circles.
PLANAR = SerialArm(
    "planar", (Joint("first"), Joint("second", Frame((1.0, 0.0, 0.0)))), tool=Frame((1.0, 0.0, 0.0))
)


@pytest.fixture(scope="module")
def poses():
    rng = np.random.default_rng(0)
    low, high = np.array(PANDA.space.lower), np.array(PANDA.space.upper)
    margin = 0.1 * (high - low)
    return PANDA.tool_frames(rng.uniform(low + margin, high - margin, (30, 7)))


def test_a_pose_that_the_arm_has_is_found_within_its_limits(poses):
    rng = np.random.default_rng(1)
    found = [solve_pose(PANDA, pose[:3, 3], rng, rotation=pose[:3, :3]) for pose in poses]
    for pose, rows in zip(poses, found, strict=True):
        tools = PANDA.tool_frames(rows)
        assert PANDA.space.contains(rows).all()
        assert (np.linalg.norm(tools[:, :3, 3] - pose[:3, 3], axis=1) <= PLACE_M).all()
        traces = np.einsum("ij,nij->n", pose[:3, :3], tools[:, :3, :3])
        assert (np.arccos(np.clip((traces - 1.0) / 2.0, -1.0, 1.0)) <= TURN_RAD).all()
    assert np.mean([len(rows) > 0 for rows in found]) > 0.95


def test_along_an_approach_any_turn_about_it_will_do(poses):
    rng = np.random.default_rng(2)
    found = [solve_pose(PANDA, pose[:3, 3], rng, approach=pose[:3, 2]) for pose in poses]
    turns = []
    for pose, rows in zip(poses, found, strict=True):
        tools = PANDA.tool_frames(rows)
        assert PANDA.space.contains(rows).all()
        assert (np.linalg.norm(tools[:, :3, 3] - pose[:3, 3], axis=1) <= PLACE_M).all()
        assert (np.arccos(np.clip(tools[:, :3, 2] @ pose[:3, 2], -1.0, 1.0)) <= TURN_RAD).all()
        turns += list(tools[:, :3, 0] @ pose[:3, 0])
    assert np.mean([len(rows) > 0 for rows in found]) > 0.95
    assert np.std(turns) > 0.3
    again = solve_pose(PANDA, poses[0][:3, 3], np.random.default_rng(2), approach=poses[0][:3, 2])
    assert np.array_equal(again, found[0])


def test_solutions_are_distinct(poses):
    apart = Solving(starts=32, distinct_rad=0.3)
    rows = solve_pose(PANDA, poses[0, :3, 3], np.random.default_rng(3), solving=apart)
    assert len(rows) > 5
    gaps = np.abs(rows[:, None] - rows).max(axis=-1)
    assert gaps[~np.eye(len(rows), dtype=bool)].min() > 0.3


@pytest.mark.parametrize("place", [(1.5, 0.0, 0.3), (0.0, 0.0, -1.2)])
def test_out_of_reach_nothing_is_found(place):
    assert solve_pose(PANDA, place, np.random.default_rng(0)).shape == (0, 7)
    sideways = solve_pose(PLANAR, (1.0, 1.0, 0.0), np.random.default_rng(0), approach=(1.0, 0.0, 0.0))
    assert sideways.shape == (0, 2)
