"""Worlds on a command line and by their robots."""

import argparse
from dataclasses import replace

import pytest
from pydantic import ValidationError

from cspace import worlds
from cspace.errors import ConfigError, ScenarioError
from cspace.worlds.planar.arm import TWO_LINK, PlanarArm
from cspace.worlds.planar.camera import Camera
from cspace.worlds.planar.world import PlanarWorld
from cspace.worlds.spatial.sensor import grid_of
from training.data.config import GeneratedConfig

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


def test_a_camera_is_asked_for_where_pictures_are_somebodys_own_alone(capsys):
    with pytest.raises(SystemExit):
        described("--pixels", "32", sensor=False)
    assert "--pixels" in capsys.readouterr().err


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


def test_a_robot_is_seen_as_those_of_its_type_are():
    assert worlds.usual_world(PANDA.body) == PANDA
    # The array of pictures is that about its own shoulder.
    assert worlds.usual_world(worlds.examples()["ur5"].body) == worlds.examples()["ur5"]
    assert worlds.usual_world(TWO_LINK) == worlds.default_world()


def test_a_configuration_takes_robots_of_any_kind_by_their_fields():
    joint, parts = {"name": "turn"}, [{"name": "tip", "link": 1, "spheres_m": [[1, 0, 0, 0.1]]}]
    baton = {"name": "baton", "joints": [joint], "parts": parts}
    found = GeneratedConfig.model_validate({"robot": baton}).world
    assert (found.kind, found.body.name) == ("spatial", "baton")
    # All that it reaches is in the array of its pictures.
    assert found.sensor == replace(PANDA.sensor, grid=grid_of(found.body))
    assert (found.sensor.grid.high_m >= 1.1).all()
    assert GeneratedConfig.model_validate({"robot": {}}).robot == TWO_LINK
    for robot in (baton | {"link_lengths_m": [1.0]}, {"parts": parts}, {"links": [1.0]}):
        with pytest.raises(ValidationError):
            GeneratedConfig.model_validate({"robot": robot})
