import pytest

from cspace.errors import ConfigError
from cspace.worlds import examples, robot_digest
from cspace.worlds.planar.arm import PlanarArm
from cspace.worlds.planar.camera import Camera
from cspace.worlds.planar.world import PlanarWorld
from services.names import (
    MAX_WORLD,
    MODEL_NAME,
    PATH_MODEL_NAME,
    may_name,
    model_name,
    recorded_name,
    robot_name,
    shown_name,
    world_tags,
)

TWO, THREE, *_ = examples().values()
OWN = PlanarWorld(PlanarArm((1.0, 1.0), joint_limits_rad=((-1.0, 1.0), None)))
DERIVED = f"planar-{robot_digest(OWN)[:8]}"


@pytest.mark.parametrize(
    ("world", "given", "robot", "model", "path_model"),
    [
        (TWO, None, "two-link", MODEL_NAME, PATH_MODEL_NAME),
        (PlanarWorld(sensor=Camera(pixels=32)), None, "two-link", MODEL_NAME, PATH_MODEL_NAME),
        (THREE, None, "three-link", "three-link-sampler", "three-link-path-sampler"),
        (OWN, None, DERIVED, f"{DERIVED}-sampler", f"{DERIVED}-path-sampler"),
        (OWN, "arm-7", "arm-7", "arm-7-sampler", "arm-7-path-sampler"),
    ],
)
def test_models_are_named_after_their_robot(world, given, robot, model, path_model):
    assert robot_name(world, given) == robot
    assert (model_name(world, given), model_name(world, given, path=True)) == (model, path_model)


@pytest.mark.parametrize(
    ("world", "given"),
    [
        (TWO, "arm-7"),
        (TWO, "three-link"),
        (OWN, "two-link"),
        (OWN, "cspace"),
        (OWN, "arm-7-path"),
        (OWN, "planar-00000000"),
        (OWN, ""),
        (OWN, "arm_7"),
        (OWN, "arm/7"),
        (OWN, "a" * 64),
    ],
)
def test_another_robots_name_and_what_is_none_are_refused(world, given):
    with pytest.raises(ConfigError, match="robot_name"):
        robot_name(world, given)


def test_a_name_is_read_from_a_configuration_that_anybody_may_have_written():
    assert recorded_name({"robot_name": "arm-7"}) == "arm-7"
    assert [recorded_name(one) for one in ({}, {"robot_name": 7}, {"robot_name": "../x"})] == [None] * 3


@pytest.mark.parametrize(
    ("model", "world", "given", "expected"),
    [
        (MODEL_NAME, TWO, None, True),
        ("three-link-sampler", TWO, None, False),
        ("three-link-sampler", THREE, None, True),
        ("three-link-path-sampler", THREE, None, True),
        ("arm-7-sampler", OWN, None, False),
        ("arm-7-sampler", OWN, "arm-7", True),
        # Of no robot in particular.
        ("team-a", TWO, None, True),
        (MODEL_NAME, OWN, None, True),
    ],
)
def test_a_models_name_fits_its_robot_or_any(model, world, given, expected):
    assert may_name(model, world, given) is expected


def test_a_world_that_is_too_long_is_left_out_of_the_tags():
    assert world_tags(OWN)["robot"] == robot_digest(OWN)
    assert len(world_tags(OWN)["world"]) < MAX_WORLD
    assert set(world_tags(PlanarWorld(PlanarArm((1.0,) * 2000)))) == {"robot"}


def test_a_name_that_is_another_s_by_now_is_not_shown():
    other = PlanarWorld(PlanarArm((1.0, 1.0)))
    assert shown_name(other, "bench") == "bench"
    assert shown_name(other, "two-link") == shown_name(other, None) == robot_name(other)
