import numpy as np
import pytest

from cspace.errors import EvaluationError
from cspace.simulator import Split
from cspace.worlds.planar.arm import THREE_LINK, TWO_LINK
from cspace.worlds.planar.camera import Camera
from cspace.worlds.planar.world import PlanarWorld
from services.evaluator.measures.scenes import Scene, Stage
from services.evaluator.measures.topology import (
    scene_topology,
    summarise_topology,
)
from tests.fakes.sample_source import FakeSampleSource
from tests.fakes.uniform_sampler import UniformSampler


def truth(of):
    """Further real samples, as a perfect generator would give them."""
    return FakeSampleSource(lambda rng, count: of.free(count, rng))


def test_no_scenarios_are_an_error(rng):
    with pytest.raises(EvaluationError, match="empty"):
        summarise_topology([], rng)


@pytest.mark.slow
@pytest.mark.parametrize("robot", [TWO_LINK, THREE_LINK])
def test_uniform_samples_are_above_the_floor_and_real_samples_at_it(robot):
    scenes = [Scene(Stage(PlanarWorld(robot, Camera()), Split.TRAIN, 0), index) for index in range(3, 9)]
    uniform, real = (
        summarise_topology(
            [scene_topology(one, sampler(one), 20, samples=1000) for one in scenes], np.random.default_rng(0)
        )["gsc_boundary"]
        for sampler in (lambda one: UniformSampler(one.space), truth)
    )
    assert uniform.score.low > uniform.floor.high
    assert real.score.low < real.floor.high
