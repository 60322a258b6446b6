import logging

import numpy as np
import pytest
import ray

from cspace.dataset import open_dataset
from cspace.errors import DatasetError, StorageError
from cspace.worlds import simulator_of
from cspace.worlds.planar.arm import PlanarArm
from cspace.worlds.planar.collision import CollisionChecker
from cspace.worlds.planar.world import Disc, Scenario
from cspace.worlds.spatial.obstacles import obstacles_of
from cspace.worlds.spatial.scenes import SpatialScene
from training.clusters.pipeline import uniform_free
from training.config import GridConfig
from training.data import generate as module
from training.data.config import DatasetConfig
from training.data.configurations import ConfigurationRecipe
from training.data.generate import generate, save_shard
from training.jobs.trials import grid_samples

SMALL = DatasetConfig(
    seed=3,
    scenario_count=5,
    free_per_scenario=20,
    collision_per_scenario=10,
    extra_image_count=4,
    shard_size=2,
)
SHARDS = ConfigurationRecipe(SMALL).plan()


class HereInsteadOfRay:
    """Makes the shards in this process, in order; stops before one of them when told to."""

    def __init__(self, monkeypatch, fail_at=None, failure=None):
        self.made, self.fail_at, self.failure = [], fail_at, failure
        monkeypatch.setattr(module, "run_tasks", self.run)

    def run(self, config, shards, partial):
        for shard in shards:
            if len(self.made) == self.fail_at:
                raise self.failure
            self.made.append(shard)
            yield str(save_shard(partial, shard, ConfigurationRecipe(config).make(shard)))


def test_the_data_set_holds_what_the_configuration_asks_for(tmp_path, monkeypatch, caplog):
    HereInsteadOfRay(monkeypatch)
    with caplog.at_level(logging.INFO, logger="training"):
        dataset = generate(SMALL, tmp_path / "data")
    # Progress where there is no terminal.
    assert f"data: {len(SHARDS)}/{len(SHARDS)}" in caplog.messages
    assert dataset.images.shape == (5, 48, 48, 3)
    assert dataset.extra_images.shape == (4, 48, 48, 3)
    assert dataset.arrays["discs"].shape == (5, 3, 3)
    assert [len(dataset.free_of(index)) for index in range(5)] == [20] * 5
    assert [len(dataset.collision_of(index)) for index in range(5)] == [10] * 5
    assert dataset.free.dtype == np.float32
    assert dataset.manifest.generator == SMALL.model_dump(mode="json")
    assert dataset.generator_seed == 3
    assert [path.name for path in tmp_path.iterdir()] == ["data"]
    open_dataset(dataset.folder, verify=True)
    config = SMALL.model_copy(update={"collision_per_scenario": 0, "extra_image_count": 0})
    bare = generate(config, tmp_path / "bare")
    assert bare.collision is None
    assert bare.extra_images is None


def test_an_interrupted_generation_goes_on_where_it_stopped(tmp_path, monkeypatch):
    first = HereInsteadOfRay(monkeypatch, fail_at=2, failure=KeyboardInterrupt())
    with pytest.raises(KeyboardInterrupt):
        generate(SMALL, tmp_path / "data")
    assert not (tmp_path / "data").exists()
    second = HereInsteadOfRay(monkeypatch)
    resumed = generate(SMALL, tmp_path / "data")
    assert first.made + second.made == SHARDS
    assert [path.name for path in tmp_path.iterdir()] == ["data"]
    whole = generate(SMALL, tmp_path / "other")
    assert resumed.digest == whole.digest


def test_shards_that_were_damaged_meanwhile_or_are_of_another_configuration_are_made_again(
    tmp_path, monkeypatch
):
    HereInsteadOfRay(monkeypatch, fail_at=3, failure=RuntimeError())
    with pytest.raises(RuntimeError):
        generate(SMALL, tmp_path / "data")
    (partial,) = tmp_path.iterdir()
    shard = SHARDS[1]
    path = partial / shard.file_name
    path.write_bytes(path.read_bytes()[:-50])
    second = HereInsteadOfRay(monkeypatch, fail_at=2, failure=RuntimeError())
    with pytest.raises(RuntimeError):
        generate(SMALL, tmp_path / "data")
    assert second.made == [shard, SHARDS[3]]
    other = HereInsteadOfRay(monkeypatch)
    assert generate(SMALL.model_copy(update={"seed": 4}), tmp_path / "data").generator_seed == 4
    assert len(other.made) == len(SHARDS)


def test_a_data_set_that_is_there_is_used_again_unless_it_is_another_or_damaged(tmp_path, monkeypatch):
    HereInsteadOfRay(monkeypatch)
    made = generate(SMALL, tmp_path / "data")
    again = HereInsteadOfRay(monkeypatch)
    assert generate(SMALL.model_copy(update={"shard_size": 1}), tmp_path / "data").digest == made.digest
    with pytest.raises(DatasetError, match=r"another data set.*another folder"):
        generate(SMALL.model_copy(update={"seed": 4}), tmp_path / "data")
    path = made.folder / "free.npy"
    path.write_bytes(path.read_bytes()[:-1] + b"\x00")
    with pytest.raises(DatasetError, match=r"free\.npy"):
        generate(SMALL, tmp_path / "data")
    assert again.made == []


def test_a_bad_folder_is_told_before_the_first_shard(tmp_path, monkeypatch):
    here = HereInsteadOfRay(monkeypatch)
    (tmp_path / "file").write_text("")
    with pytest.raises(StorageError, match="cannot be written"):
        generate(SMALL, tmp_path / "file" / "data")
    assert here.made == []
    assert [path.name for path in tmp_path.iterdir()] == ["file"]


@pytest.fixture(scope="module")
def cluster():
    with pytest.MonkeyPatch.context() as patch:
        # Ray looks once a process: with a token here, clusters of later tests would be refused theirs.
        patch.setenv("RAY_AUTH_MODE", "disabled")
        patch.delenv("RAY_ADDRESS", raising=False)
        ray.init(num_cpus=2, include_dashboard=False, log_to_driver=False, logging_level=logging.ERROR)
        yield
        ray.shutdown()


@pytest.mark.slow
@pytest.mark.usefixtures("cluster")
def test_ray_tasks_make_the_same_data_set(tmp_path, monkeypatch):
    by_ray = generate(SMALL, tmp_path / "ray")
    HereInsteadOfRay(monkeypatch)
    here = generate(SMALL, tmp_path / "here")
    assert by_ray.digest == here.digest
    assert {path.name for path in tmp_path.iterdir()} == {"ray", "here"}


@pytest.mark.slow
@pytest.mark.usefixtures("cluster")
def test_an_error_in_a_ray_task_arrives_as_it_was_raised(tmp_path):
    # A robot so short that it never collides.
    config = SMALL.model_copy(update={"robot": PlanarArm((0.1, 0.1))})
    with pytest.raises(DatasetError, match="hardly any configuration") as caught:
        generate(config, tmp_path / "data")
    assert type(caught.value) is DatasetError
    assert not (tmp_path / "data").exists()


PROPOSED = SMALL.model_copy(update={"proposals_per_scenario": 30, "extra_image_count": 0})


def attribute_of(dataset, name, scenario):
    """An attribute of one scenario's configurations."""
    offsets = dataset.arrays[f"{name.partition('_')[0]}_offsets"]
    return dataset.arrays[name][offsets[scenario] : offsets[scenario + 1]]


def test_proposals_are_kept_all_with_their_clearance_and_origin(tmp_path, monkeypatch):
    HereInsteadOfRay(monkeypatch)
    dataset = generate(PROPOSED, tmp_path / "data")
    discs = tuple(Disc(*values) for values in dataset.arrays["discs"][2].tolist())
    checker = CollisionChecker(Scenario(dataset.world.body, discs, dataset.world.sensor))
    counts = set()
    for scenario in range(5):
        free, hit = dataset.free_of(scenario), dataset.collision_of(scenario)
        counts.add((len(free), len(hit)))
        assert len(free) + len(hit) == 30
        origins = np.concatenate(
            [attribute_of(dataset, f"{side}_origin", scenario) for side in ("free", "collision")]
        )
        assert np.bincount(origins).tolist() == [15, 15]
    assert len(counts) > 1
    for side, sign in (("free", 1), ("collision", -1)):
        rows = dataset.free_of(2) if side == "free" else dataset.collision_of(2)
        clearance = attribute_of(dataset, f"{side}_clearance", 2)
        np.testing.assert_allclose(clearance, checker.clearance(rows), atol=1e-5)
        assert (sign * clearance >= 0.0).all()
    near = dataset.arrays["free_clearance"][dataset.arrays["free_origin"] == 1]
    assert (near <= 0.1 + 1e-5).all()


def test_samplers_learn_from_what_was_drawn_uniformly(tmp_path, monkeypatch):
    HereInsteadOfRay(monkeypatch)
    dataset = generate(PROPOSED, tmp_path / "data")
    free, ids = uniform_free(dataset)
    expected = [dataset.free_of(row)[attribute_of(dataset, "free_origin", row) == 0] for row in range(5)]
    np.testing.assert_array_equal(free, np.concatenate(expected))
    np.testing.assert_array_equal(ids, np.repeat(np.arange(5), [len(rows) for rows in expected]))
    plain = generate(SMALL, tmp_path / "plain")
    np.testing.assert_array_equal(uniform_free(plain)[0], plain.free)


@pytest.mark.slow
def test_data_of_an_arm_in_space_hold_arrays_of_space_and_every_kind_of_configuration(tmp_path, monkeypatch):
    HereInsteadOfRay(monkeypatch)
    config = DatasetConfig(robot="panda", scenario_count=3, proposals_per_scenario=60, extra_image_count=0)
    dataset = generate(config, tmp_path / "data")
    assert dataset.images.shape == (3, 80, 80, 80, 2)
    assert dataset.world.kind == "spatial"
    samples = grid_samples(dataset, GridConfig())
    assert samples.offsets.tolist() == [0, 60, 120, 180]
    origins = np.concatenate([dataset.arrays[f"{side}_origin"] for side in ("free", "collision")])
    assert np.bincount(origins).tolist() == [36, 36, 45, 27, 36]
    # What hits an obstacle is in collision; of the others some touch the arm itself.
    hit = samples.hits.any(dim=1).numpy()
    free = samples.free.numpy()
    assert not (hit & free).any()
    assert 0 < hit.sum() <= (~free).sum()
    obstacles = obstacles_of(*(dataset.arrays[name][1] for name in ("boxes", "cylinders")))
    again = simulator_of(dataset.world).checker(SpatialScene(dataset.world, obstacles, ()))
    assert again.valid_batch(dataset.free_of(1)).all()
    assert not again.valid_batch(dataset.collision_of(1)).any()
