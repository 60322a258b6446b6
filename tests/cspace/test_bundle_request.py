"""A query is held against its bundle once, whoever does it first."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from cspace.bundle import Bundle
from cspace.bundle.spec import fitted_configurations, fitted_end
from cspace.errors import InputError
from cspace.worlds.planar.arm import PlanarArm
from cspace.worlds.planar.world import PlanarWorld


@pytest.fixture(scope="module")
def bundle(tiny_bundle: Path) -> Bundle:
    return Bundle.load(tiny_bundle)


def test_configurations_are_wrapped_where_joints_are_circles_and_held_within_limits(bundle: Bundle) -> None:
    world = PlanarWorld(PlanarArm(joint_limits_rad=((-2.9, 4.0), None)))
    spec = replace(bundle.spec, world=world)
    found = fitted_configurations([[3.9, 7.0], [-2.9, -4.0]], spec)
    assert found.dtype == np.float32
    assert np.allclose(found, [[3.9, 7.0 - 2 * np.pi], [-2.9, -4.0 + 2 * np.pi]])
    with pytest.raises(InputError, match="outside the limits") as refused:
        fitted_configurations([[0.0, 0.0], [4.1, 0.0], [-3.0, 0.0]], spec)
    assert "2 of 3 rows outside, the first is row 1: joint 1 at 4.1 rad" in str(refused.value.got)
    for wrong in ([0.0, 1.0], [[0.0]], np.empty((0, 2)), [["a", "b"]], [[True, False]]):
        with pytest.raises(InputError, match="do not fit the robot"):
            fitted_configurations(wrong, spec)


def test_angles_in_degrees_are_refused_although_the_joints_are_circles(bundle: Bundle) -> None:
    with pytest.raises(InputError, match=r"joint 1 at 47.08 rad; .*degrees"):
        fitted_configurations([[47.08, -79.14]], bundle.spec)
    with pytest.raises(InputError, match=r"start lies outside.*joint 2 at -79.14 rad"):
        fitted_end(bundle.spec, "start", (0.1, -79.14))
