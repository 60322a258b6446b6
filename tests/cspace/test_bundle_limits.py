"""Bundles of limited joints: whatever their graphs give, every answer lies within the limits."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from cspace.bundle import Bundle, write_bundle
from cspace.space import JointSpace
from cspace.worlds.planar.arm import PlanarArm
from tests.bundles import picture, tiny_graphs, tiny_spec, write_tiny_bundle

ARMS = {
    "mixed": PlanarArm(joint_limits_rad=(None, (-1.0, 0.5))),
    "box": PlanarArm(joint_limits_rad=((-2.9, 4.0), (0.1, 0.7))),
    "wide": PlanarArm(joint_limits_rad=((-7.0, 7.0), (-9.0, -5.0))),
}


def inside(space: JointSpace, samples: np.ndarray) -> bool:
    """As real numbers, circles in [-pi, pi)."""
    exact = samples.astype(np.float64)
    below = np.where(space.periodic, exact < space.upper, exact <= space.upper)
    return bool(np.all((exact >= space.lower) & below))


@pytest.fixture(params=list(ARMS))
def robot(request: pytest.FixtureRequest) -> PlanarArm:
    return ARMS[request.param]


def test_no_answer_holds_a_configuration_outside_the_limits(tmp_path: Path, robot: PlanarArm) -> None:
    spec = tiny_spec(robot)
    graphs = tiny_graphs(spec, validity=True, scale=3.0)
    bundle = Bundle.load(write_bundle(tmp_path / "bundle", spec, graphs))
    for least in (0.0, 0.1):
        samples = bundle.sample(picture(), 4000, 1, min_confidence=least, epsilon_sigma=(0.0, 5.0)).samples
        assert len(samples)
        assert inside(robot.space, samples)


def test_no_path_sample_lies_outside_the_limits(tmp_path: Path, robot: PlanarArm) -> None:
    bundle = Bundle.load(write_tiny_bundle(tmp_path / "bundle", robot, kind="path", scale=5.0))
    start, goal = robot.space.sample_uniform(np.random.default_rng(0), 2)
    assert inside(robot.space, bundle.sample(picture(), 4000, 1, start=start, goal=goal).samples)


@pytest.mark.parametrize("least", [0.0, 0.1])
def test_samples_beyond_narrower_limits_are_rejected_and_none_is_moved_to_a_limit(
    tmp_path: Path, least: float
) -> None:
    spec = tiny_spec(PlanarArm(joint_limits_rad=((-3.2, 3.2), (-3.2, 3.2))))
    graphs = tiny_graphs(spec, validity=True)
    wide = Bundle.load(write_bundle(tmp_path / "bundle", spec, graphs))
    found = wide.sample(picture(), 1000, 1, min_confidence=0.0).samples
    low, high = np.quantile(found[:, 0].astype(np.float64), [0.2, 0.9])
    arm = PlanarArm(joint_limits_rad=((float(low), float(high)), (-3.2, 3.2)))
    narrow = wide.within(replace(wide.spec.world, body=arm))
    samples = narrow.sample(picture(), 1000, 1, min_confidence=least).samples
    assert len(samples) == 1000
    assert inside(arm.space, samples)
    assert not np.isin(samples[:, 0], np.float32([low, high])).any()
    kept = (found[:, 0] > low) & (found[:, 0] < high)
    if not least:
        np.testing.assert_array_equal(samples[kept], found[kept])
    assert narrow.sample(picture(), 1000, 1, min_confidence=least).samples.tobytes() == samples.tobytes()
    assert wide.sample(picture(), 1000, 1, min_confidence=0.0).samples.tobytes() == found.tobytes()
