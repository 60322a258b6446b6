from dataclasses import replace

import numpy as np
import pytest

from cspace.errors import EvaluationError
from cspace.simulator import Split
from cspace.worlds import simulator_of
from cspace.worlds.planar.arm import THREE_LINK, TWO_LINK, PlanarArm
from cspace.worlds.planar.camera import Camera
from cspace.worlds.planar.problems import Family, draw_problem
from cspace.worlds.planar.world import Disc, PlanarWorld, Scenario
from services.evaluator.measures.scenes import (
    Scene,
    Stage,
    measure_reconstruction,
    reconstruct,
)
from tests.fakes.sample_source import FakeSampleSource
from tests.fakes.uniform_sampler import UniformSampler
from tests.scenarios import random_scenarios

STAGE = Stage(PlanarWorld(TWO_LINK, Camera()), Split.VALIDATION, 5)


def blocked(scene, discs):
    scene.__dict__["scenario"] = Scenario(TWO_LINK, discs)
    return scene


def test_scenes_are_the_split_s_scenarios():
    expected = random_scenarios(Split.VALIDATION, 5, 3)
    assert [Scene(STAGE, index).scenario for index in range(3)] == expected


@pytest.mark.parametrize("family", [Family.NARROW, Family.DISCONNECTED])
def test_scenes_of_a_family_are_those_of_its_problems_seen_by_the_evaluation_s_camera(family):
    camera = Camera(pixels=32)
    scene = Scene(replace(STAGE, world=PlanarWorld(TWO_LINK, camera)), 1, family)
    expected = draw_problem(family, Split.VALIDATION, 5, 1)
    assert scene.scenario == replace(expected.scenario, camera=camera)
    assert np.array_equal(scene.problem.start, expected.start)
    assert Scene(STAGE, 1, family, expected).problem is expected


def test_streams_are_reproducible_and_differ_by_number_family_and_scene():
    scene = Scene(STAGE, 1)
    first, again = (scene.rng(0).random() for _ in range(2))
    assert first == again
    scenes = [Scene(STAGE, 1, family) for family in simulator_of(STAGE.world).families.names]
    assert len({one.rng(stream).random() for one in scenes for stream in range(5)}) == 15
    assert scene.sampler_seed(0) != scene.sampler_seed(1) != Scene(STAGE, 2).sampler_seed(1)


def test_free_configurations_are_free_and_collisions_are_not():
    scene = Scene(STAGE, 0)
    assert scene.checker.valid_batch(scene.free(500, scene.rng(0))).all()
    collisions = scene.collisions(500, scene.rng(0))
    assert collisions.shape == (500, 2)
    assert not scene.checker.valid_batch(collisions).any()


def test_a_scene_without_an_obstacle_in_reach_has_no_collisions():
    scene = blocked(Scene(STAGE, 0), (Disc(40.0, 40.0),))
    assert scene.collisions(100, scene.rng(0)).shape == (0, 2)


def test_a_scene_without_free_space_is_an_error():
    scene = blocked(Scene(STAGE, 0), (Disc(0.0, 0.0),))
    with pytest.raises(EvaluationError, match="no free space"):
        scene.free(10, scene.rng(0))


WIDE = PlanarArm(joint_limits_rad=((-7.0, 7.0), (-4.0, 1.0)))


@pytest.mark.parametrize(("robot", "share"), [(TWO_LINK, 0.3), (THREE_LINK, 0.3), (WIDE, 1.0)])
def test_uniform_samples_score_as_uniform_and_real_ones_as_real(robot, share):
    scene = Scene(Stage(PlanarWorld(robot, Camera()), Split.VALIDATION, 5), 0)
    quality = reconstruct(scene, UniformSampler(robot.space), samples=300)
    assert quality.real.precision == 1.0
    assert quality.sampler.precision == pytest.approx(quality.uniform.precision, abs=0.1)
    assert abs(quality.real.energy) < share * quality.uniform.energy


def test_a_sampler_that_repeats_one_free_configuration_is_precise_and_covers_nothing():
    scene = Scene(STAGE, 0)
    collapsed = FakeSampleSource(lambda rng, n: np.tile(scene.free(1, scene.rng(0)), (n, 1)))
    quality = reconstruct(scene, collapsed, samples=400)
    assert quality.sampler.precision == 1.0
    assert quality.sampler.coverage < 0.05
    assert (quality.sampler.knn_precision, quality.sampler.knn_recall) == (1.0, 0.0)
    assert quality.sampler.energy > quality.uniform.energy


def test_a_sampler_is_measured_over_scenarios_with_intervals():
    summary = measure_reconstruction(STAGE, UniformSampler(TWO_LINK.space), scenarios=3, samples=200)
    assert summary.sampler.precision.count == 3
    assert summary.real.precision.estimate == 1.0
    assert summary.precision_gain.low < 0.05


def test_no_scenarios_are_an_error():
    with pytest.raises(EvaluationError):
        measure_reconstruction(STAGE, UniformSampler(TWO_LINK.space), scenarios=0)
