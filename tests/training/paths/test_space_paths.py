"""Path models of an arm in space: they learn from pictures on disk, and serve beside the source's head."""

import numpy as np
import pytest
import torch

from cspace.bundle import Bundle
from cspace.bundle.golden import scene
from cspace.simulator import Split
from cspace.worlds import simulator_of
from cspace.worlds.spatial.checks import CollisionChecker
from cspace.worlds.spatial.obstacles import obstacles_of
from tests.cspace.worlds.spatial.test_problems import reaches_into
from tests.space_bundle import LATENT, WORLD, write_space_bundle
from tests.training.models.test_path_models import answer
from training.config import PathTrainConfig
from training.data.config import PathDatasetConfig
from training.data.paths import PathRecipe
from training.models.autoencoders import network_size
from training.models.lookups import make_lookups, read
from training.models.mixture import look
from training.models.paths import Condition, swept
from training.models.settings import FlowConfig, LookupConfig, PathGanConfig
from training.paths.bundling import PointSampler, point_graph
from training.paths.writing import write_path_bundle
from training.trials import paths as module
from training.trials.paths import make_path_module, path_arrays

DATA = PathDatasetConfig(
    robot="panda", scenario_count=2, narrow_share=0.0, pairs_per_scenario=3, points_per_path=17, shard_size=1
)
SMALL = {"hidden": 16, "layers": 2, "batch_size": 8, "steps": 2, "lookups": LookupConfig(groups=11)}
GAN = SMALL | {"critic_hidden": 16, "critic_layers": 2}
TRAIN = PathTrainConfig(
    flow=FlowConfig(**SMALL, evaluations=2),
    wgan=PathGanConfig(**GAN | {"lookups": LookupConfig()}),
)
NAMES = ("flow", "wgan")


@pytest.fixture(scope="module")
def dataset(tmp_path_factory):
    recipe = PathRecipe(DATA)
    return recipe.write(tmp_path_factory.mktemp("paths") / "data", recipe.make)


@pytest.fixture(scope="module")
def source(tmp_path_factory):
    return Bundle.load(write_space_bundle(tmp_path_factory.mktemp("source") / "bundle"))


@pytest.fixture
def stored(source, dataset, monkeypatch):
    """Arrays whose pictures stay on disk."""
    monkeypatch.setattr(module, "HELD_BYTES", 0)
    return path_arrays(source, dataset, 17)


def test_pictures_on_disk_are_read_as_those_in_memory(source, dataset, monkeypatch):
    np.testing.assert_array_equal(path_arrays(source, dataset, 17).images, dataset.images)
    monkeypatch.setattr(module, "HELD_BYTES", 0)
    stored = path_arrays(source, dataset, 17)
    assert stored.images == dataset.folder.absolute()
    assert torch.equal(stored.scenes().images, torch.tensor(np.asarray(dataset.images)))
    np.testing.assert_array_equal(stored.mu[1], source.encode(dataset.images[1]).mu)


@pytest.mark.slow
@pytest.mark.parametrize("name", NAMES)
def test_every_model_takes_steps_and_its_graph_answers_as_the_network_does(name, stored, source, tmp_path):
    trained = make_path_module(name, TRAIN, stored, 0)
    before = {key: value.clone() for key, value in trained.net.state_dict().items()}
    for step in range(2):
        trained.training_step(step, 0)
    assert all(np.isfinite(list(trained.metrics().values())))
    after = trained.eval().net.state_dict()
    assert any(not torch.equal(before[key], after[key]) for key in before)

    config = getattr(TRAIN, name)
    lookups = make_lookups(config.lookups, WORLD)
    sampler = PointSampler(trained.net, lookups, place=config.place, sweep=4)
    graph = point_graph(sampler, LATENT, network_size(WORLD.sensor))
    assert graph.looks_at_picture == (name == "flow")
    rng, picture = np.random.default_rng(1), scene(WORLD.sensor.picture_shape)
    ends = {end: np.repeat(WORLD.space.sample_uniform(rng, 1), 5, 0) for end in ("start", "goal")}
    sizes = {item.name: item.shape[0] for item in graph.random_inputs} | {"latent": LATENT}
    fed = {key: rng.random((5, size)) for key, size in sizes.items()} | ends
    fed |= {"image": WORLD.sensor.to_network(picture[None])} if lookups else {}
    fed = {key: value.astype(np.float32) for key, value in fed.items()}
    tensors = {key: torch.tensor(value) for key, value in fed.items()}
    place = swept(tensors["place"], 4) if config.place else None
    condition = Condition(tensors["latent"], tensors["start"], tensors["goal"], place)
    with torch.no_grad():
        wanted = trained.net(
            condition, tensors["noise"], lambda at: look(lookups, tensors.get("image"), at)
        ).numpy()
    np.testing.assert_allclose(answer(graph.model, fed)[:, 0], wanted, atol=1e-4)

    bundle = write_path_bundle(tmp_path / name, source, graph, None, {}, {})
    assert (bundle.spec.kind, bundle.spec.looks_at_map) == ("path", False)
    found = bundle.sample(picture, 30, 1, start=fed["start"][0], goal=fed["goal"][0])
    assert WORLD.space.contains(found.samples).all()
    # The head still looks at its map.
    np.testing.assert_array_equal(bundle.score(picture, found.samples), source.score(picture, found.samples))
    assert found.confidence.shape == found.unseen.shape == (30,)


def test_a_flow_is_told_what_the_picture_shows_at_its_points(stored):
    trained = make_path_module("flow", TRAIN, stored, 0)
    batch = trained.samples.draw(6, trained.rng)
    points = batch.points.clone().requires_grad_()
    seen = read(trained.reader, batch.ids, points)
    assert seen.shape == (6, make_lookups(TRAIN.flow.lookups, WORLD).values)
    (slope,) = torch.autograd.grad(seen.sum(), points)
    # Every joint but the last moves some group.
    assert (slope[:, :-1].abs().amax(dim=0) > 0.0).all()


def test_paths_run_free_between_ends_that_are_apart(dataset):
    rows, offsets = dataset.arrays["paths"], dataset.arrays["path_offsets"]
    for number, owner in enumerate(dataset.arrays["path_scenario"]):
        boxes, cylinders = (dataset.arrays[name][owner] for name in WORLD.scene_files)
        checker = CollisionChecker(WORLD.body, obstacles_of(boxes, cylinders))
        path = np.asarray(rows[offsets[number] : offsets[number + 1]], np.float64)
        assert len(path) == 17
        # Corners are cut between two points.
        assert checker.valid_batch(path).mean() > 0.9
        assert checker.valid_batch(path[[0, -1]]).all()
        first, last = WORLD.body.tool_frames(path[[0, -1]])[:, :3, 3]
        assert np.linalg.norm(first - last) >= 0.15


def test_ends_reach_into_regions_and_the_arm_sets_out_where_it_waits():
    simulator = simulator_of(WORLD)
    scene = simulator.scene(np.random.default_rng(3), Split.TRAIN, 0)
    pairs = list(simulator.ends(scene, np.empty((0, 7)), np.random.default_rng(0), 12))
    assert 3 <= len(pairs) <= 12
    checker = simulator.checker(scene)
    reached = np.zeros((len(pairs), 2), np.bool_)
    for number, pair in enumerate(pairs):
        assert checker.valid_batch(pair).all()
        for region in scene.regions:
            reached[number] |= reaches_into(WORLD.body, pair, region)
    assert reached.any(axis=1).all()
    assert any(np.array_equal(pair[0], scene.state) for pair in pairs)
