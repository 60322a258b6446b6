"""A query is held against its bundle once, whoever does it first."""

from dataclasses import replace

import numpy as np
import pytest

from cspace.bundle import Bundle
from cspace.bundle.request import FittedQuery, fitted, fitted_configurations
from cspace.errors import InputError
from cspace.query import SampleQuery
from cspace.worlds.planar.arm import PlanarArm
from cspace.worlds.planar.world import PlanarWorld
from tests.bundles import picture, write_tiny_bundle


@pytest.fixture(scope="module")
def bundle(tmp_path_factory: pytest.TempPathFactory) -> Bundle:
    return Bundle.load(write_tiny_bundle(tmp_path_factory.mktemp("request") / "bundle", validity=True))


def test_a_query_that_fits_is_not_judged_again_nor_is_it_with_another_seed(bundle: Bundle) -> None:
    query = fitted(SampleQuery(5, 1, robot=bundle.robot), bundle.spec, has_validity=True)
    assert query.min_confidence == (bundle.spec.confidence_threshold or 0.0)
    other = replace(query, seed=2)
    assert isinstance(other, FittedQuery)
    assert fitted(other, bundle.spec, has_validity=True) is other


def test_a_fitted_query_gives_the_samples_of_the_query_itself(bundle: Bundle) -> None:
    query = SampleQuery(50, 3, min_confidence=0.5, robot=bundle.robot)
    fits = fitted(query, bundle.spec, has_validity=True)
    one, other = (bundle.answer(picture(), asked) for asked in (query, fits))
    assert one.samples.tobytes() == other.samples.tobytes()


def test_configurations_are_wrapped_where_joints_are_circles_and_held_within_limits(bundle: Bundle) -> None:
    world = PlanarWorld(PlanarArm(joint_limits_rad=((-2.9, 4.0), None)))
    spec = replace(bundle.spec, world=world)
    found = fitted_configurations([[3.9, 7.0], [-2.9, -4.0]], spec)
    assert found.dtype == np.float32
    assert np.allclose(found, [[3.9, 7.0 - 2 * np.pi], [-2.9, -4.0 + 2 * np.pi]])
    with pytest.raises(InputError, match="outside the limits") as refused:
        fitted_configurations([[0.0, 0.0], [4.1, 0.0], [-3.0, 0.0]], spec)
    assert "2 of 3, the first in row 1: (4.1, 0)" in str(refused.value.got)
    for wrong in ([0.0, 1.0], [[0.0]], np.empty((0, 2)), [["a", "b"]], [[True, False]]):
        with pytest.raises(InputError, match="do not fit the robot"):
            fitted_configurations(wrong, spec)
