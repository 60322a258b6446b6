"""Arms of limited joints from the data set to the answer: nothing that is served lies outside the limits."""

import numpy as np
import pytest

from cspace.files import encode_png
from cspace.simulator import Split
from cspace.worlds.planar.arm import PlanarArm
from cspace.worlds.planar.camera import decode_png
from cspace.worlds.planar.simulator import render
from tests.scenarios import random_scenarios
from tests.training.clusters.test_pipeline import bundle_of, submit

pytestmark = [pytest.mark.e2e, pytest.mark.slow, pytest.mark.timeout(600)]

# A limited joint beside a circle, by one generator; two, one beyond half a turn, by a gated mixture.
ARMS = {
    "mixed": (PlanarArm(joint_limits_rad=(None, (-2.0, 2.5))), "smoke"),
    "box": (PlanarArm(joint_limits_rad=((-2.9, 4.0), (-1.5, 1.2))), "smoke_mixture"),
}
SAMPLES = 10_000


@pytest.fixture(scope="module", params=list(ARMS))
def trained(request, server, tmp_path_factory):
    """The arm, its bundle, and the folder of its data sets."""
    robot, preset = ARMS[request.param]
    folder = tmp_path_factory.mktemp(request.param)
    overrides = (limits_of(robot), "validity.threshold=0.05")
    result = submit(server, folder, "--preset", preset, *chosen(overrides))
    return robot, bundle_of(server, result["model"], result["version"], folder / "bundle"), folder


def limits_of(robot):
    limits = ", ".join("null" if one is None else str(list(one)) for one in robot.joint_limits_rad)
    return f"data.robot.joint_limits_rad=[{limits}]"


def chosen(overrides):
    return [part for override in overrides for part in ("--set", override)]


def pictures(robot):
    return [decode_png(encode_png(render(one)), 48) for one in random_scenarios(Split.DEMO, 0, 3, robot)]


def outside(robot, samples):
    """How many rows lie outside as real numbers, circles in [-pi, pi)."""
    space, exact = robot.space, samples.astype(np.float64)
    below = np.where(space.periodic, exact < space.upper, exact <= space.upper)
    return int(np.sum(~np.all((exact >= space.lower) & below, axis=1)))


@pytest.mark.parametrize("least", [0.0, None])
def test_no_served_sample_lies_outside(trained, least):
    robot, bundle, _ = trained
    assert bundle.spec.world.space == robot.space
    for seed, image in enumerate(pictures(robot)):
        found = bundle.sample(image, SAMPLES, seed, min_confidence=least, epsilon_sigma=(0.0, 1.0))
        assert len(found.samples) > SAMPLES / 10
        assert outside(robot, found.samples) == 0
        assert np.ptp(found.samples, axis=0).min() > 1.0


def test_a_generator_puts_no_lump_on_the_limits(trained):
    robot, bundle, _ = trained
    samples = bundle.sample(pictures(robot)[0], SAMPLES, 5, min_confidence=0.0).samples
    at_limit = np.isin(samples, robot.space.to_float32([robot.space.lower, robot.space.upper]))
    assert at_limit.mean() < 1e-3


def test_no_path_sample_lies_outside(trained, server):
    robot, bundle, folder = trained
    overrides = (
        f"source={bundle.folder}", limits_of(robot),
        "data.narrow_share=0",
    )  # fmt: skip
    result = submit(server, folder, "--preset", "smoke", *chosen(overrides), script="path_train.py")
    start, goal = robot.space.lower, np.mean([robot.space.lower, robot.space.upper], axis=0)
    made = bundle_of(server, result["model"], result["version"], folder / "paths")
    samples = made.sample(pictures(robot)[0], 2000, 1, start=start, goal=goal).samples
    assert len(samples) == 2000
    assert outside(robot, samples) == 0
