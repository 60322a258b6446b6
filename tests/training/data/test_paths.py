"""Data sets of paths: what a scenario's paths are, and that they do not depend on where they are made."""

import numpy as np
import pytest

from cspace.dataset import open_dataset
from cspace.errors import DatasetError
from cspace.worlds.planar.arm import THREE_LINK, TWO_LINK
from cspace.worlds.planar.collision import CollisionChecker
from cspace.worlds.planar.problems import FINE_CELLS, NARROW_RAD, FreeGrid
from cspace.worlds.planar.simulator import render
from cspace.worlds.planar.world import Disc, Scenario
from training.data import generate as module
from training.data.config import DatasetConfig, PathDatasetConfig
from training.data.generate import generate, save_shard
from training.data.paths import PathRecipe

SMALL = PathDatasetConfig(
    seed=5, scenario_count=4, narrow_share=0.25, pairs_per_scenario=3, points_per_path=33, shard_size=2
)


@pytest.fixture(scope="module")
def dataset(tmp_path_factory):
    recipe = PathRecipe(SMALL)
    return recipe.write(tmp_path_factory.mktemp("paths") / "data", recipe.make)


def scenario(dataset, index):
    return Scenario(TWO_LINK, tuple(Disc(*map(float, row)) for row in dataset.arrays["discs"][index]))


def paths_of(dataset, index):
    owner, offsets = dataset.arrays["path_scenario"], dataset.arrays["path_offsets"]
    rows = dataset.arrays["paths"]
    return [np.asarray(rows[offsets[k] : offsets[k + 1]], np.float64) for k in np.flatnonzero(owner == index)]


def test_every_scenario_has_its_picture_and_as_many_paths_of_as_many_points_as_asked_for(dataset):
    assert dataset.scenario_count == 4
    for index in range(4):
        assert np.array_equal(dataset.images[index], render(scenario(dataset, index)))
        assert [path.shape for path in paths_of(dataset, index)] == [(33, 2)] * 3
    assert dataset.manifest.generator == SMALL.model_dump(mode="json")
    open_dataset(dataset.folder, verify=True)


def test_paths_are_free_and_their_points_lie_at_equal_distances(dataset):
    for index in range(4):
        checker = CollisionChecker(scenario(dataset, index))
        for path in paths_of(dataset, index):
            assert checker.valid_batch(path).mean() > 0.99
            steps = np.linalg.norm(TWO_LINK.space.difference(path[:-1], path[1:]), axis=1)
            # Corners are cut between two points, never lengthened.
            assert steps.max() <= steps.mean() * 1.2 + 1e-6


def test_only_the_first_scenarios_have_a_narrow_passage_on_every_way(dataset):
    low, high = NARROW_RAD
    grid = FreeGrid(scenario(dataset, 0), FINE_CELLS)
    for path in paths_of(dataset, 0):
        assert low - 0.01 <= grid.bottleneck_rad(path[0], path[-1]) <= high + 0.01


def test_a_scenario_is_the_same_whatever_the_shards(dataset):
    whole = PathRecipe(SMALL.model_copy(update={"shard_size": 4}))
    (shard,) = whole.plan()
    made = whole.make(shard)
    assert np.array_equal(made["images"], dataset.images)
    for index in range(4):
        np.testing.assert_allclose(np.stack(paths_of(dataset, index)), made["paths"][index], atol=1e-6)


def test_the_key_tells_paths_from_configurations_and_one_source_from_the_other(tmp_path, monkeypatch):
    other = SMALL.model_copy(update={"source": "rrt_star"})
    assert len({SMALL.key, other.key, DatasetConfig(seed=5, scenario_count=4).key}) == 3

    def here(config, shards, partial):
        recipe = module.recipe_of(config)
        return [str(save_shard(partial, shard, recipe.make(shard))) for shard in shards]

    monkeypatch.setattr(module, "run_tasks", here)
    few = SMALL.model_copy(update={"scenario_count": 1, "narrow_share": 0.0})
    made = generate(few, tmp_path / "paths")
    assert generate(few, tmp_path / "paths").digest == made.digest
    with pytest.raises(DatasetError):
        generate(DatasetConfig(scenario_count=1), tmp_path / "paths")


def test_the_papers_source_gives_paths_that_are_about_as_short(tmp_path):
    few = SMALL.model_copy(update={"scenario_count": 2, "narrow_share": 0.0, "pairs_per_scenario": 2})
    slow = PathRecipe(few.model_copy(update={"source": "rrt_star", "time_limit_s": 0.3}))
    rrt_star = slow.make(slow.plan()[0])
    space = TWO_LINK.space
    for index, paths in enumerate(rrt_star["paths"]):
        discs = tuple(Disc(*map(float, row)) for row in rrt_star["discs"][index])
        checker = CollisionChecker(Scenario(TWO_LINK, discs))
        for path in paths:
            assert checker.valid_batch(path).mean() > 0.99
            length = np.linalg.norm(space.difference(path[:-1], path[1:]), axis=1).sum()
            straight = float(np.linalg.norm(space.difference(path[0], path[-1])))
            assert length >= straight - 1e-6


THREE = SMALL.model_copy(update={"robot": THREE_LINK, "scenario_count": 2})


def test_three_joints_have_paths_too():
    recipe = PathRecipe(THREE.model_copy(update={"narrow_share": 0.0}))
    (shard,) = recipe.plan()
    made = recipe.make(shard)
    assert made["paths"].shape == (2, 3, 33, 3)
    for discs, paths in zip(made["discs"], made["paths"], strict=True):
        robot = THREE.world.body
        checker = CollisionChecker(Scenario(robot, tuple(Disc(*map(float, row)) for row in discs)))
        assert checker.valid_batch(paths.reshape(-1, 3)).all()
