"""Measures on joint spaces with limits: the ends of a limited joint are far apart."""

import numpy as np
import pytest

from cspace.simulator import Split
from cspace.space import JointSpace, circles
from cspace.worlds.planar.arm import PlanarArm
from cspace.worlds.planar.world import PlanarWorld
from services.evaluator.measures.sample_quality import coverage, energy_distance
from services.evaluator.measures.scenes import Scene, Stage, reconstruct
from services.evaluator.measures.topology import occupancy, sample_complement
from tests.fakes.uniform_sampler import UniformSampler

SEAM = JointSpace((-3.1, -np.pi), (3.1, np.pi), (False, True))
WIDE = PlanarArm(joint_limits_rad=((-7.0, 7.0), (-4.0, 1.0)))


def at(first, count=50):
    return np.random.default_rng(0).normal((first, 0.0), 0.01, (count, 2))


def test_the_two_ends_of_a_limited_joint_are_apart():
    low, high = at(-3.05), at(3.05)
    assert coverage(low, high, SEAM, 0.2) == 0.0
    assert coverage(low, high, circles(2), 0.2) == 1.0
    assert energy_distance(low, high, circles(2)) < 0.4
    assert energy_distance(low, high, SEAM) > 10.0


def test_uniform_samples_fill_limits_beyond_a_turn():
    samples = UniformSampler(WIDE.space).sample(b"", 20_000, seed=0).samples
    assert WIDE.space.holds(samples).all()
    np.testing.assert_allclose(samples.min(axis=0), WIDE.space.lower, atol=0.01)
    np.testing.assert_allclose(samples.max(axis=0), WIDE.space.upper, atol=0.01)
    assert occupancy(samples, WIDE.space).sum() == len(samples)


def test_the_complement_of_a_cloud_lies_within_the_limits():
    half = WIDE.space.sample_uniform(np.random.default_rng(0), 2000)
    half = half[half[:, 0] < 0.0]
    rest = sample_complement(half, WIDE.space, np.random.default_rng(1), 500)
    assert WIDE.space.contains(rest).all()
    assert np.mean(rest[:, 0] > 0.0) > 0.95


def test_real_samples_of_a_limited_arm_are_judged_as_real_ones():
    scene = Scene(Stage(PlanarWorld(WIDE), Split.TEST, 0), 0)
    quality = reconstruct(scene, UniformSampler(WIDE.space), 300)
    assert quality.real.precision == 1.0
    assert quality.sampler.precision == pytest.approx(quality.uniform.precision, abs=0.1)
    assert quality.real.energy < quality.uniform.energy
