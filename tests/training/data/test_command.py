import os
import subprocess
import sys

import numpy as np
import pytest
from PIL import Image

from cspace.dataset import open_dataset
from cspace.worlds.planar.camera import Camera
from training.data.__main__ import main


@pytest.fixture
def own(tmp_path):
    folder = tmp_path / "own"
    folder.mkdir()
    for name in ("first", "second"):
        Image.new("RGB", (64, 64), (255, 255, 255)).save(folder / f"{name}.png")
        np.save(folder / f"{name}.npy", np.zeros((5, 3)))
    return folder


@pytest.fixture
def three(tmp_path):
    """The options of a robot with three links, one of which has limits."""
    path = tmp_path / "three.yaml"
    path.write_text(
        "robot: {link_lengths_m: [1.6, 1.4, 1.0], joint_limits_rad: [null, [-1.0, 2.0], null]}\n"
        "camera: {x_min_m: -4, x_max_m: 4, y_min_m: -3, y_max_m: 3, pixels: 32}\n"
    )
    return ["--robot", str(path)]


def test_own_data_of_three_links_are_imported_and_verified(own, three, tmp_path, capsys):
    assert main(["import", str(own), str(tmp_path / "data"), *three]) == 0
    dataset = open_dataset(tmp_path / "data")
    assert dataset.world.body.link_lengths_m == (1.6, 1.4, 1.0)
    assert dataset.world.body.joint_limits_rad == (None, (-1.0, 2.0), None)
    assert dataset.world.sensor == Camera(-4.0, 4.0, -3.0, 3.0, 32)
    assert dataset.images.shape == (2, 32, 32, 3)
    assert main(["verify", str(tmp_path / "data")]) == 0
    assert dataset.digest in capsys.readouterr().out


def test_a_damaged_data_set_ends_with_one_and_names_the_file(own, three, tmp_path, capsys):
    main(["import", str(own), str(tmp_path / "data"), *three])
    path = tmp_path / "data" / "free.npy"
    path.write_bytes(path.read_bytes()[:-1] + b"\x01")
    assert main(["verify", str(tmp_path / "data")]) == 1
    assert "free.npy is damaged" in capsys.readouterr().err


@pytest.mark.parametrize(
    "robot",
    [
        "robot: {link_lengths_m: [2.0, -1.0]}",
        "robot: {link_lengths_m: [2, 1], joint_limits_rad: [null]}",
        "{",
    ],
)
def test_a_robot_that_cannot_be_ends_with_two(own, tmp_path, robot, capsys):
    path = tmp_path / "robot.yaml"
    path.write_text(robot)
    assert main(["import", str(own), str(tmp_path / "data"), "--robot", str(path)]) == 2
    assert f"error: {path}" in capsys.readouterr().err
    assert not (tmp_path / "data").exists()


def test_a_count_that_cannot_be_ends_with_two(tmp_path, capsys):
    assert main(["generate", str(tmp_path / "data"), "--scenario-count", "0"]) == 2
    assert "scenario_count does not fit" in capsys.readouterr().err


GENERATE = ("generate", "--scenario-count", "6", "--extra-image-count", "4", "--shard-size", "3")


@pytest.mark.slow
def test_the_command_generates_with_a_ray_of_its_own_in_a_shell_for_jobs(tmp_path):
    command = [sys.executable, "-m", "training.data", GENERATE[0], str(tmp_path / "data")]
    counts = [*GENERATE[1:], "--seed", "9"]
    environment = os.environ | {"RAY_ADDRESS": "http://127.0.0.1:8265"}
    done = subprocess.run(
        [*command, *counts], env=environment, capture_output=True, text=True, timeout=110, check=False
    )
    assert done.returncode == 0, done.stderr
    assert "data: 4/4" in done.stderr
    assert open_dataset(tmp_path / "data").generator_seed == 9
