"""The acceptance of GS-C in small."""

import numpy as np
import pytest

from cspace.simulator import Split
from cspace.worlds.planar.arm import TWO_LINK
from cspace.worlds.planar.camera import Camera
from cspace.worlds.planar.world import PlanarWorld
from services.evaluator.measures.scenes import Scene, Stage
from services.evaluator.measures.topology import (
    POINTS_PER_CELL,
    complement_score,
    sample_complement,
    turned_living_times,
)
from services.evaluator.statistics import mean_interval

SPACE = TWO_LINK.space
SAMPLES = 2000
DRAWS = 80
REPEATS = 10


def measured(cloud, rng):
    complement = sample_complement(cloud, SPACE, rng, SAMPLES)
    return tuple(turned_living_times(one, SPACE, rng, draws=DRAWS) for one in (cloud, complement))


def gsc(first, second):
    return complement_score(first[0], second[0], first[1], second[1])


def interval(values):
    return mean_interval(values, np.random.default_rng(0))


@pytest.mark.slow
@pytest.mark.timeout(600)
def test_real_noisy_and_uniform_samples_have_gsc_intervals_apart():
    scene = Scene(Stage(PlanarWorld(TWO_LINK, Camera()), Split.TRAIN, 0), 3)
    found = {"real": [], "noise": [], "uniform": []}
    for repeat in range(REPEATS):
        rng = np.random.default_rng([1, repeat])
        reference, again, base = (scene.free(SAMPLES, rng) for _ in range(3))
        noisy = SPACE.wrap(base + rng.normal(0.0, 0.1, base.shape))
        clouds = {"real": again, "noise": noisy, "uniform": SPACE.sample_uniform(rng, SAMPLES)}
        target = measured(reference, rng)
        for name, cloud in clouds.items():
            found[name].append(gsc(target, measured(cloud, rng)))
    real, noise, uniform = (interval(found[name]) for name in ("real", "noise", "uniform"))
    assert real.high < noise.low
    assert noise.high < uniform.low


def room(rng, wall_rad):
    """Free space with obstacles all round, two cells wide, and a wall through its middle."""
    half = np.pi - 4.0 * np.pi / int((SAMPLES / POINTS_PER_CELL) ** 0.5)
    inside = rng.uniform(-half, half, (2 * SAMPLES, 2))
    return inside[np.abs(inside[:, 0]) >= wall_rad / 2.0][:SAMPLES]


@pytest.mark.slow
@pytest.mark.timeout(600)
def test_a_wall_that_divides_the_free_space_is_seen_by_gsc():
    wall_rad = 4.0 * np.pi / int((SAMPLES / POINTS_PER_CELL) ** 0.5)
    floors, scores = [], []
    for repeat in range(REPEATS // 2):
        rng = np.random.default_rng([2, repeat])
        whole, again, divided, still = (measured(room(rng, wall), rng) for wall in (0, 0, wall_rad, wall_rad))
        floors.append(max(gsc(whole, again), gsc(divided, still)))
        scores.append(gsc(whole, divided))
    assert interval(scores).low > interval(floors).high
