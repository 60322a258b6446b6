"""Worlds on a command line and by their robots, one kind and two."""

import argparse
import sys
from dataclasses import dataclass
from types import ModuleType

import pytest
from pydantic import ValidationError

from cspace import worlds
from cspace.errors import ConfigError, ScenarioError
from cspace.worlds.planar.arm import TWO_LINK, PlanarArm
from cspace.worlds.planar.camera import Camera
from cspace.worlds.planar.world import PlanarWorld
from training.data.config import GeneratedConfig


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


@dataclass(frozen=True)
class Crane:
    """A robot of another kind."""

    height_m: float
    cables: int = 1

    @property
    def dim(self):
        return 1 + self.cables


@dataclass(frozen=True)
class Yard:
    body: Crane
    sensor: str = "from above"


@pytest.fixture
def two_kinds(monkeypatch):
    world = ModuleType("cspace.worlds.yard.world")
    world.PARTS = {"body": (Crane,), "sensor": (), "scenes": ()}
    world.EXAMPLES = {"crane": Yard(Crane(9.0), "from the side")}
    world.add_options = lambda parser, sensor: parser.add_argument("--crane", type=float)
    world.described = lambda given: None if given.crane is None else Yard(Crane(given.crane))
    for module in (ModuleType("cspace.worlds.yard"), world):
        monkeypatch.setitem(sys.modules, module.__name__, module)
    monkeypatch.setattr(worlds, "KINDS", ("planar", "yard"))


@pytest.mark.usefixtures("two_kinds")
def test_a_second_kind_is_described_by_options_of_its_own():
    assert described("--crane", "30") == Yard(Crane(30.0))
    assert described("--links", "1") == PlanarWorld(PlanarArm((1.0,)))


@pytest.mark.usefixtures("two_kinds")
def test_a_robot_is_seen_as_the_first_example_of_its_type():
    assert worlds.usual_world(Crane(5.0, 2)) == Yard(Crane(5.0, 2), "from the side")
    assert worlds.usual_world(TWO_LINK) == worlds.default_world()


@pytest.mark.usefixtures("two_kinds")
def test_a_configuration_takes_robots_of_any_kind_by_their_fields():
    class Both(GeneratedConfig):
        """Its fields are gathered while there are two kinds."""

        robot: GeneratedConfig.__annotations__["robot"] = TWO_LINK

    assert Both.model_validate({"robot": {"height_m": 4}}).world == Yard(Crane(4.0), "from the side")
    assert Both.model_validate({"robot": {}}).robot == TWO_LINK
    for robot in ({"height_m": 4, "link_lengths_m": [1.0]}, {"cables": 2}, {"links": [1.0]}):
        with pytest.raises(ValidationError):
            Both.model_validate({"robot": robot})
