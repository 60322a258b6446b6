import pytest

from cspace.errors import EvaluationError
from cspace.simulator import Split
from cspace.worlds.planar.arm import THREE_LINK, TWO_LINK
from cspace.worlds.planar.camera import Camera
from cspace.worlds.planar.world import PlanarWorld
from services.evaluator.measures.scenes import Scene, Stage
from services.evaluator.measures.topology_scenes import (
    SCORES,
    repeated_topology,
    scene_topology,
    summarise_topology,
)
from tests.fakes.sample_source import FakeSampleSource
from tests.fakes.uniform_sampler import UniformSampler


def scene(robot=TWO_LINK):
    return Scene(Stage(PlanarWorld(robot, Camera()), Split.TRAIN, 0), 3)


def truth(of):
    """Further real samples, as a perfect generator would give them."""
    return FakeSampleSource(lambda rng, count: of.free(count, rng))


def test_repeats_are_independent_of_each_other_and_of_their_number():
    sampler = UniformSampler(TWO_LINK.space)
    rows = [scene_topology(scene(), sampler, 4, samples=300, repeat=repeat) for repeat in range(3)]
    again = scene_topology(scene(), sampler, 4, samples=300, repeat=2)
    assert again == rows[2]
    assert len({row.gsc_boundary.score for row in rows}) == 3
    assert len({row.gsc_boundary.floor for row in rows}) == 3


def test_one_scenario_has_intervals_over_its_repeats():
    summary = repeated_topology(scene(), UniformSampler(TWO_LINK.space), draws=2, repeats=5, samples=100)
    assert set(summary) == set(SCORES)
    for one in summary.values():
        for interval in (one.score, one.floor):
            assert interval.low < interval.estimate < interval.high
            assert interval.count == 5


def test_no_repeats_are_an_error():
    with pytest.raises(EvaluationError, match="empty"):
        repeated_topology(scene(), UniformSampler(TWO_LINK.space), draws=2, repeats=0, samples=100)


def test_no_scenarios_are_an_error(rng):
    with pytest.raises(EvaluationError, match="empty"):
        summarise_topology([], rng)


@pytest.mark.slow
@pytest.mark.parametrize("robot", [TWO_LINK, THREE_LINK])
def test_uniform_samples_are_above_the_floor_and_real_samples_at_it(robot):
    of = scene(robot)
    uniform = repeated_topology(of, UniformSampler(robot.space), draws=20, repeats=8, samples=1000)
    real = repeated_topology(of, truth(of), draws=20, repeats=8, samples=1000)
    assert uniform["gsc_boundary"].score.low > uniform["gsc_boundary"].floor.high
    assert real["gsc_boundary"].score.low < real["gsc_boundary"].floor.high
