"""A query is held against its bundle once, whoever does it first."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from cspace.bundle import Bundle
from cspace.bundle.samples import FittedQuery, fitted, fitted_configurations, fitted_end
from cspace.errors import InputError
from cspace.query import SampleQuery
from cspace.worlds.planar.arm import PlanarArm
from cspace.worlds.planar.world import PlanarWorld
from tests.bundles import picture


@pytest.fixture(scope="module")
def bundle(tiny_bundle: Path) -> Bundle:
    return Bundle.load(tiny_bundle)


def test_a_query_that_fits_is_not_judged_again_nor_is_it_with_another_seed(bundle: Bundle) -> None:
    query = fitted(SampleQuery(5, 1, robot=bundle.robot), bundle.spec, has_validity=True)
    assert query.min_confidence == (bundle.spec.confidence_threshold or 0.0)
    other = replace(query, seed=2)
    assert isinstance(other, FittedQuery)
    assert fitted(other, bundle.spec, has_validity=True) is other


def test_a_fitted_query_gives_the_samples_of_the_query_itself(bundle: Bundle) -> None:
    query = SampleQuery(50, 3, min_confidence=0.5, robot=bundle.robot)
    fits = fitted(query, bundle.spec, has_validity=True)
    one, other = (bundle.answer(picture(), each) for each in (query, fits))
    assert one.samples.tobytes() == other.samples.tobytes()


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


def test_limits_in_single_precision_are_taken_at_every_field(bundle: Bundle) -> None:
    limits = (-2.8973, 2.8973), (-3.7525, 3.7525)
    spec = replace(bundle.spec, world=PlanarWorld(PlanarArm(joint_limits_rad=limits)))
    upper = np.float32([2.8973, 3.7525])
    assert not spec.world.space.contains(upper)
    found = fitted_configurations(upper[None], spec)
    assert spec.world.space.contains(found).all()
    np.testing.assert_array_equal(fitted_end(spec, "goal", tuple(upper.tolist())), found[0].tolist())
    with pytest.raises(InputError, match=r"goal lies outside the limits.*joint 2 at 3.7527"):
        fitted_end(spec, "goal", (0.0, 3.7527))


def test_angles_in_degrees_are_refused_although_the_joints_are_circles(bundle: Bundle) -> None:
    with pytest.raises(InputError, match=r"joint 1 at 47.08 rad; .*degrees"):
        fitted_configurations([[47.08, -79.14]], bundle.spec)
    with pytest.raises(InputError, match=r"start lies outside.*joint 2 at -79.14 rad"):
        fitted_end(bundle.spec, "start", (0.1, -79.14))
