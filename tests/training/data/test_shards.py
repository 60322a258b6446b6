import numpy as np
import pytest

from cspace.simulator import Split
from cspace.worlds.planar.arm import THREE_LINK, PlanarArm
from cspace.worlds.planar.collision import CollisionChecker
from cspace.worlds.planar.simulator import render
from cspace.worlds.planar.world import Scenario
from tests.scenarios import random_scenarios
from training.data.config import DatasetConfig, PathDatasetConfig, Shard
from training.data.configurations import ConfigurationRecipe, sample_configurations
from training.data.generate import load_shard, save_shard

SMALL = DatasetConfig(
    seed=3,
    scenario_count=5,
    free_per_scenario=40,
    collision_per_scenario=20,
    extra_image_count=3,
    shard_size=2,
)
THREE = SMALL.model_copy(update={"robot": THREE_LINK})
LIMITED = SMALL.model_copy(update={"robot": PlanarArm(joint_limits_rad=(None, (-1.0, 2.0)))})


def joined(config, *, extra=False):
    recipe = ConfigurationRecipe(config)
    parts = [recipe.make(shard) for shard in recipe.plan() if shard.extra is extra]
    return {name: np.concatenate([part[name] for part in parts]) for name in parts[0]}


@pytest.mark.parametrize("config", [SMALL, THREE, LIMITED], ids=["two", "three", "limited"])
def test_configurations_are_what_they_are_said_to_be(config):
    arrays, robot = joined(config), config.world.body
    assert arrays["free"].shape == (5, 40, robot.dim)
    assert arrays["collision"].shape == (5, 20, robot.dim)
    for index in range(5):
        scenario = Scenario.from_array(robot, arrays["discs"][index])
        checker = CollisionChecker(scenario)
        assert checker.valid_batch(arrays["free"][index]).all()
        assert not checker.valid_batch(arrays["collision"][index]).any()
        assert robot.space.contains(arrays["collision"][index]).all()
        np.testing.assert_array_equal(arrays["images"][index], render(scenario))
    discs = [scenario.disc_array for scenario in random_scenarios(Split.TRAIN, 3, 5, robot)]
    np.testing.assert_array_equal(arrays["discs"], discs)
    pictures = np.concatenate([arrays["images"], joined(config, extra=True)["images"]])
    assert len({picture.tobytes() for picture in pictures}) == 8


def test_the_content_does_not_depend_on_the_size_of_the_shards():
    for extra in (False, True):
        small = joined(SMALL, extra=extra)
        large = joined(SMALL.model_copy(update={"shard_size": 100}), extra=extra)
        assert small.keys() == large.keys()
        for name in small:
            np.testing.assert_array_equal(small[name], large[name])


def test_free_configurations_are_uniform_over_the_free_space():
    scenario = random_scenarios(Split.DEMO, 1, 1)[0]
    rng = np.random.default_rng(0)
    drawn = sample_configurations(CollisionChecker(scenario), 20_000, rng, free=True)
    assert len(drawn) == 20_000
    uniform = scenario.robot.space.sample_uniform(rng, 60_000)
    uniform = uniform[CollisionChecker(scenario).valid_batch(uniform)]
    bins = np.linspace(-np.pi, np.pi, 9)
    ours, theirs = (np.histogram2d(q[:, 0], q[:, 1], bins=[bins, bins])[0] / len(q) for q in (drawn, uniform))
    # A cell holds a 64th at most of 20,000; five standard errors of the difference.
    assert np.abs(ours - theirs).max() < 5 * np.sqrt(2 * (1 / 40) / 20_000)


def test_a_shard_that_is_damaged_counts_as_missing(tmp_path):
    shard = Shard(0, 2, extra=True)
    path = save_shard(tmp_path, shard, ConfigurationRecipe(SMALL).make(shard))
    whole = path.read_bytes()
    middle = len(whole) // 2
    changed = whole[:middle] + bytes([whole[middle] ^ 255]) + whole[middle + 1 :]
    for damaged in (b"", whole[:100], whole[:-10], changed):
        path.write_bytes(damaged)
        assert load_shard(tmp_path, shard) is None
    path.unlink()
    assert load_shard(tmp_path, shard) is None


@pytest.mark.parametrize(
    ("config", "key"),
    [
        (DatasetConfig(), "7476c8678ee2"),
        (PathDatasetConfig(), "1f0125b182a8"),
        (THREE, "b1635dc6f04a"),
        (LIMITED, "b4444c1d23fb"),
    ],
)
def test_data_that_were_made_before_are_found_again_by_their_key(config, key):
    assert config.key == key
    assert type(config).model_validate(config.model_dump(mode="json")) == config
    assert config.model_copy(update={"shard_size": 7}).key == key
    assert config.model_copy(update={"seed": 4}).key != key
    assert config.model_copy(update={"split": "test"}).key != key
