"""Worlds on a command line and by their robots."""

import argparse

import pytest

from cspace import worlds
from cspace.errors import ConfigError, ScenarioError
from cspace.worlds.planar.arm import PlanarArm
from cspace.worlds.planar.camera import Camera
from cspace.worlds.planar.world import PlanarWorld

PANDA = worlds.examples()["panda"]


def described(*arguments, sensor=True):
    parser = argparse.ArgumentParser()
    worlds.add_world_options(parser, sensor=sensor)
    return worlds.described_world(parser.parse_args(arguments))


@pytest.mark.parametrize("sensor", [False, True])
def test_without_options_the_world_is_the_first_example(sensor):
    assert described(sensor=sensor) == worlds.default_world()


def test_options_say_what_the_arm_and_its_camera_are():
    arm = ("--links", "1", "2", "3", "--half-width", "0.2", "--limit", "2", "-1", "2")
    found = described(*arm, "--pixels", "32", "--view", "-4", "4", "-3", "3")
    robot = PlanarArm((1.0, 2.0, 3.0), 0.2, (None, (-1.0, 2.0), None))
    assert found == PlanarWorld(robot, Camera(-4.0, 4.0, -3.0, 3.0, 32))
    assert described(*arm, sensor=False) == PlanarWorld(robot)
    assert described("--arm", "panda") == PANDA


@pytest.mark.parametrize(
    ("arguments", "error"),
    [
        (("--limit", "3", "-1", "2"), ConfigError),
        (("--limit", "1.5", "-1", "2"), ConfigError),
        (("--view", "5", "-5", "-5", "5"), ConfigError),
        (("--links", "0"), ScenarioError),
    ],
)
def test_options_that_cannot_be_are_refused(arguments, error):
    with pytest.raises(error):
        described(*arguments)
