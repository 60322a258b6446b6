"""Data of a robot's own file and of scenes of one's own, by the command."""

import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from cspace.dataset import open_dataset
from cspace.simulator import Split
from cspace.worlds import simulator_of
from cspace.worlds.planar.collision import CollisionChecker
from cspace.worlds.planar.world import DiscScenes, GivenScenes, Scenario
from training.data.__main__ import main

ROBOT = """\
robot: {link_lengths_m: [1.6, 1.4], joint_limits_rad: [null, [-2.5, 2.5]]}
scenes: {count: [1, 5], radius_m: [0.3, 0.4]}
"""
FEW = ("--free-per-scenario", "20", "--collision-per-scenario", "5", "--shard-size", "4")


@pytest.fixture
def robot(tmp_path: Path) -> Path:
    path = tmp_path / "robot.yaml"
    path.write_text(ROBOT)
    return path


def generate(folder: Path, *options: str) -> None:
    """Run the command as a user does."""
    command = [sys.executable, "-m", "training.data", "generate", str(folder), *FEW, *options]
    environment = os.environ | {"RAY_ADDRESS": "local", "OMP_NUM_THREADS": "1"}
    done = subprocess.run(command, env=environment, capture_output=True, text=True, check=False, timeout=110)
    assert done.returncode == 0, done.stdout + done.stderr


@pytest.mark.e2e
@pytest.mark.slow
def test_data_of_a_family_hold_its_scenes(robot: Path, tmp_path: Path) -> None:
    folder = tmp_path / "family"
    counts = ("--scenario-count", "8", "--extra-image-count", "3")
    generate(folder, "--robot", str(robot), *counts)
    data = open_dataset(folder)
    assert data.world.scenes == DiscScenes((1, 5), (0.3, 0.4))
    assert data.arrays["discs"].shape == (8, 5, 3)
    for index in range(8):
        scene = Scenario.from_array(data.world.body, data.arrays["discs"][index])
        assert CollisionChecker(scene).valid_batch(data.free_of(index)).all()
        assert not CollisionChecker(scene).valid_batch(data.collision_of(index)).any()
    generate(folder, "--robot", str(robot), *counts)


@pytest.mark.e2e
@pytest.mark.slow
def test_given_scenes_are_taken_once_each_and_some_are_held_out(robot: Path, tmp_path: Path) -> None:
    scenes = tmp_path / "scenes"
    scenes.mkdir()
    for number in range(7):
        discs = f"obstacles: [{{x_m: {1 + number / 4}, y_m: 1.5, radius_m: 0.3}}]\n"
        (scenes / f"{number}.yaml").write_text(ROBOT + discs)
    folder = tmp_path / "given"
    generate(folder, "--robot", str(robot), "--scenes", str(scenes))
    data = open_dataset(folder)
    given = data.world.scenes
    assert isinstance(given, GivenScenes)
    assert (len(data.images), len(given.train), len(given.held_out)) == (6, 6, 1)
    assert sorted(data.arrays["discs"][:, 0, 0]) == [1.0, 1.25, 1.5, 1.75, 2.25, 2.5]
    (held_out,) = simulator_of(data.world).scenes(Split.TEST, 0, 10)
    assert held_out.disc_array.tolist() == [[2.0, 1.5, 0.3]]
    pictures = {picture.tobytes() for picture in np.asarray(data.images)}
    assert len(pictures) == 6
    assert simulator_of(data.world).render(held_out).tobytes() not in pictures


def test_scenes_that_are_none_end_with_two(robot, tmp_path, capsys):
    scenes = tmp_path / "scenes"
    scenes.mkdir()
    command = ["generate", str(tmp_path / "data"), "--robot", str(robot), "--scenes", str(scenes)]
    assert main(command) == 2
    assert "holds no scene files" in capsys.readouterr().err
    (scenes / "one.yaml").write_text(ROBOT)
    assert main(command) == 2
    assert "holds no scene" in capsys.readouterr().err
