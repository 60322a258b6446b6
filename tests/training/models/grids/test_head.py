"""A head of arrays of space: what is seen is exact, and its graphs answer as it does."""

from dataclasses import replace

import numpy as np
import onnxruntime
import pytest
import torch

from cspace.bundle.runtime import Graph
from cspace.worlds import examples
from cspace.worlds.spatial.arm import grouped, ready_rad
from cspace.worlds.spatial.collision import CollisionChecker
from cspace.worlds.spatial.obstacles import Obstacles
from cspace.worlds.spatial.visibility import lookup
from cspace.worlds.spatial.world import shipped, usual
from tests.training.models.grids.plain_head import plain_answers
from training.config import GridConfig, ValidityConfig
from training.models.checkpoint import fit_module, seeded_initialisation
from training.models.grid_head import GridHead
from training.models.grid_training import (
    ArmSamples,
    GridBatch,
    GridHeadModule,
    GridSamples,
    grid_validity_graph,
    head_losses,
    map_graph,
)
from training.models.kinematics import ArmFrames, SelfGap

WORLD = examples()["panda"]
ARM, GRID = WORLD.body, WORLD.sensor.grid
UR5 = shipped("ur5")
SMALL = ValidityConfig(
    hidden=8,
    steps=4,
    pictures_per_step=2,
    configurations_per_picture=6,
    grid=GridConfig(width=4, middle=4, deep=4),
)


@pytest.fixture(scope="module")
def head():
    with seeded_initialisation(0):
        return GridHead.of(SMALL, WORLD).eval()


@pytest.fixture(scope="module")
def picture():
    """A wall of which one side is seen, and what is free before it."""
    found = np.zeros(WORLD.sensor.picture_shape, np.uint8)
    x = GRID.centres_m()[..., 0]
    found[..., 0] = np.minimum(np.abs(x - 0.45) / 0.0004, 255.0).round()
    found[..., 1] = np.where(x > 0.45, np.clip((x - 0.45) * 100.0, 1.0, 253.0), 0.0)
    found[:5, ..., 1], found[5:9, ..., 1] = 255, 254
    return found


@pytest.fixture(scope="module")
def rows():
    return WORLD.space.to_float32(WORLD.space.sample_uniform(np.random.default_rng(3), 40))


def to_network(picture):
    return torch.from_numpy(WORLD.sensor.to_network(picture[None]))


def test_a_groups_direction_is_that_to_its_farthest_sphere(head, rows):
    found = grouped(ARM, 64)
    radii = found.spheres_m[found.links > 0, 3]
    ways = np.linalg.norm((head.group_ways @ head.frames(torch.from_numpy(rows))).numpy(), axis=0).T * 0.1
    assert (ways <= radii + 1e-6).all()
    assert (ways + ARM.spheres_m()[:, 3].max() >= 0.5 * radii).all()


@pytest.mark.parametrize("name", ["panda", "ur5"])
def test_an_arm_that_touches_itself_is_known_exactly(name):
    world = examples()[name]
    gap, frames = SelfGap(world.grid_arm(64)), ArmFrames(world.grid_arm(64))
    drawn = world.space.to_float32(world.space.sample_uniform(np.random.default_rng(5), 1500))
    checker = CollisionChecker(world.body, Obstacles.of([]))
    near = np.abs(checker.clearance(drawn)) < 1e-6
    found = gap(frames(torch.from_numpy(drawn))).numpy() > 0.0
    np.testing.assert_array_equal(found[~near], checker.valid_batch(drawn)[~near])
    assert 0.02 < found.mean() < 0.98
    assert near.sum() < 3
    # Where no ball round spheres meets another, no spheres are looked at.
    waiting = world.space.to_float32(np.repeat(ready_rad(world.body)[None], 3, axis=0))
    assert (gap(frames(torch.from_numpy(waiting))) > 0.0).all()


def test_the_head_says_what_it_says_computed_straight_on(head, picture):
    rows = WORLD.space.to_float32(WORLD.space.sample_uniform(np.random.default_rng(6), 1000))
    image = to_network(np.roll(picture, 11, axis=2))
    with torch.no_grad():
        clear, unseen = plain_answers(head, ARM, WORLD.grid_arm(64), image, torch.from_numpy(rows))
        belief = head(image, head.encode(image), torch.from_numpy(rows)[None])
    # A sphere's middle that lies on the border of two voxels may be counted to either.
    for found, wanted in ((belief.clear[0].exp(), clear), (belief.unseen[0], unseen)):
        assert ((found - wanted).abs() > 1e-5).float().mean() <= 1e-3
    assert clear.std() > 1e-3


def test_what_is_seen_is_read_as_the_array_has_it(head, picture, rows):
    moving = ARM.sphere_links() > 0
    radii, spheres = ARM.spheres_m()[moving, 3], ARM.sphere_centres_m(rows)[:, moving]
    known = lookup(picture, GRID, spheres)
    margins, unseen = (
        found.T for found in head.at_spheres(to_network(picture), head.frames(torch.from_numpy(rows)), None)
    )
    np.testing.assert_allclose(margins, known.distance_m - radii, atol=1e-5)
    np.testing.assert_array_equal(unseen.reshape(known.unseen.shape) > 0.5, known.unseen)
    belief = believe(head, picture, rows)
    share = known.unseen @ (radii**3 / (radii**3).sum())
    np.testing.assert_allclose(belief.unseen[0], share, atol=1e-5)


def believe(head, picture, rows):
    with torch.no_grad():
        image = to_network(picture)
        return head(image, head.encode(image), torch.from_numpy(rows)[None])


@pytest.mark.parametrize("name", ["panda", "ur5"])
def test_of_an_arm_that_no_camera_saw_all_is_unseen_and_no_more(name):
    world = examples()[name]
    with seeded_initialisation(0):
        dark = GridHead.of(SMALL, world).eval()
    rows = torch.from_numpy(world.space.to_float32(world.space.sample_uniform(np.random.default_rng(0), 300)))
    nothing = torch.full((1, 2, *dark.counts), 0.6)
    with torch.no_grad():
        unseen = dark(nothing, dark.encode(nothing), rows.unsqueeze(0)).unseen
    # The volumes of an arm's spheres may sum to a little more than 1.
    assert unseen.max() <= 1.0
    assert unseen.min() > 0.999


def test_scenes_do_not_mix_within_a_batch(head, picture, rows):
    other = np.roll(picture, 7, axis=0)
    images = torch.cat([to_network(picture), to_network(other)])
    both = torch.from_numpy(np.stack([rows, rows[::-1].copy()]))
    with torch.no_grad():
        found = head(images, head.encode(images), both)
    for at, (one, ask) in enumerate(((picture, rows), (other, rows[::-1].copy()))):
        alone = believe(head, one, ask)
        np.testing.assert_allclose(found.free[at], alone.free[0], atol=1e-5)
        np.testing.assert_allclose(found.hazards[at], alone.hazards[0], atol=1e-4)


@pytest.mark.slow
def test_the_graphs_answer_as_the_network(head, picture, rows):
    image = {"image": to_network(picture).numpy()}
    seen = run(map_graph(head), image)[0]
    graph = grid_validity_graph(head, WORLD.dim)
    for count in (1, len(rows)):
        confidence, unseen = run(graph, image | {"map": seen, "configurations": rows[:count]})
        belief = believe(head, picture, rows[:count])
        np.testing.assert_allclose(confidence, belief.free[0], atol=1e-5)
        np.testing.assert_allclose(unseen, belief.unseen[0], atol=1e-5)


def run(graph, feeds):
    return onnxruntime.InferenceSession(graph, providers=["CPUExecutionProvider"]).run(None, feeds)


@pytest.mark.slow
def test_the_map_of_an_arm_that_reaches_far_may_be_opened():
    longer = tuple(
        replace(one, origin=replace(one.origin, xyz_m=tuple(1.5 * x for x in one.origin.xyz_m)))
        for one in UR5.joints
    )
    world = usual(replace(UR5, joints=longer))
    assert world.sensor.grid.counts == (128, 128, 128)
    sizes = GridConfig(finest=12, width=4, middle=4, deep=4)
    graph = map_graph(GridHead.of(SMALL.model_copy(update={"grid": sizes}), world).eval())
    opened = Graph("map.onnx", graph, {"image"}, {"map"})
    assert opened.fixed_shape("map") == (64**3, 12)


def batch(picture, rows, hits):
    free = torch.from_numpy(np.arange(len(rows)) % 3 > 0)[None]
    image = torch.from_numpy(np.moveaxis(picture, -1, 0)[None].copy())
    return GridBatch(image, torch.from_numpy(rows)[None], free, hits)


@pytest.mark.parametrize("quarters", [1, 2])
def test_a_turned_scene_is_the_same_to_a_turned_arm(head, picture, rows, quarters):
    first = batch(np.roll(picture, 5, axis=0), rows, torch.zeros(1, len(rows), 0, dtype=torch.bool))
    found = [
        head.at_spheres(one.images.float() / 255.0, head.frames(one.configurations[0]), None)
        for one in (first, first.turned(quarters))
    ]
    np.testing.assert_allclose(found[0][0], found[1][0], atol=1e-5)
    assert (found[0][1] != found[1][1]).float().mean() < 1e-3


def test_where_the_groups_truth_is_known_it_is_learned_too(head, picture, rows):
    # Whether the arm touches itself is known, so that nothing is learned from such configurations.
    alone = torch.from_numpy(np.arange(len(rows)) % 4 > 0)[None]
    belief = replace(believe(head, picture, rows), itself=alone.float())
    held = batch(picture, rows, torch.zeros(1, len(rows), 0, dtype=torch.bool))
    unknown = head_losses(belief, held)
    assert set(unknown) == {"validity_loss"}
    log_free = belief.clear.clamp(max=-1e-6)
    each = -torch.where(held.free, log_free, torch.log(-torch.expm1(log_free)))
    assert unknown["validity_loss"].item() == pytest.approx(each[alone].mean().item(), rel=1e-5)
    hits = torch.zeros(1, len(rows), head.groups, dtype=torch.bool)
    hits[0, 3, 2] = True
    known = head_losses(belief, batch(picture, rows, hits))
    clear = np.arange(len(rows)) != 3
    log_free = belief.clear[0].clamp(max=-1e-6)
    each = -torch.where(torch.from_numpy(clear), log_free, torch.log(-torch.expm1(log_free)))
    assert known["validity_loss"].item() == pytest.approx(each.mean().item(), rel=1e-5)
    wrong = torch.nn.functional.binary_cross_entropy_with_logits(belief.hazards, hits.float())
    assert known["hazard_loss"].item() == pytest.approx(wrong.item(), rel=1e-5)


def samples(picture, rows):
    images = np.stack([picture, np.roll(picture, 9, axis=0)])
    free = torch.from_numpy(np.arange(len(rows)) % 3 > 0)
    hits = (~free)[:, None].expand(-1, GridHead.of(SMALL, WORLD).groups)
    return GridSamples(images, torch.from_numpy(rows), free, hits, torch.tensor([0, 15, len(rows)]))


def with_arms(held, *worlds):
    worlds = worlds or (WORLD,)
    return ArmSamples(worlds, (held,) * len(worlds))


def test_configurations_are_drawn_from_their_own_scenario(picture, rows):
    held = samples(picture, rows)
    found = held.draw(200, 4, torch.Generator().manual_seed(1))
    drawn = {one.tobytes() for one in found.configurations.reshape(-1, rows.shape[1]).numpy()}
    assert drawn == {one.tobytes() for one in rows}
    for image, drawn in zip(found.images.numpy(), found.configurations.numpy(), strict=True):
        scenario = int(not np.array_equal(np.moveaxis(image, 0, -1), picture))
        own = rows[:15] if scenario == 0 else rows[15:]
        assert (drawn[:, None] == own).all(axis=2).any(axis=1).all()


@pytest.mark.slow
def test_training_lowers_the_loss(picture, rows):
    config = SMALL.model_copy(update={"steps": 30, "learning_rate": 0.02})
    with seeded_initialisation(1):
        module = GridHeadModule(config, with_arms(samples(picture, rows)), 0)
    losses = []
    for _ in range(10):
        fit_module(module, 3)
        losses += [module.metrics()["validity_loss"]]
    assert np.mean(losses[-4:]) < 0.8 * losses[0]
    assert set(module.metrics()) == {"validity_loss", "hazard_loss", "validity_accuracy"}


def test_an_arm_that_stands_off_the_grids_middle_is_not_turned(picture, rows):
    aside = replace(GRID, low_m=(GRID.low_m[0] + 0.1, *GRID.low_m[1:]))
    world = replace(WORLD, sensor=replace(WORLD.sensor, grid=aside))
    assert GridHeadModule(SMALL, with_arms(samples(picture, rows), world), 0).turns == [1]
    assert GridHeadModule(SMALL, with_arms(samples(picture, rows)), 0).turns == [4]
