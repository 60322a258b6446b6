"""What arrays of space say where an arm's groups of spheres would be."""

import numpy as np
import pytest
import torch

from cspace.errors import ConfigError
from cspace.worlds import examples
from cspace.worlds.planar.arm import TWO_LINK
from cspace.worlds.planar.camera import Camera
from cspace.worlds.planar.world import PlanarWorld
from training.models.lookups import Scenes, SpaceLookups, SpaceReader, make_lookups, make_reader
from training.models.settings import LookupConfig

WORLD = examples()["panda"]
# As few as the arm has parts.
GROUPS = 11
SHAPE = WORLD.sensor.picture_shape


def pictures(count=2):
    rng = np.random.default_rng(4)
    images = rng.integers(256, size=(count, *SHAPE), dtype=np.uint8)
    # Random bytes are hardly ever free.
    images[..., 1] *= rng.random((count, *SHAPE[:3])) < 0.5
    return images


def configurations(count):
    rows = WORLD.space.sample_uniform(np.random.default_rng(5), count)
    return torch.tensor(rows, dtype=torch.float32)


def centres_m(rows):
    """Of the groups, (n, G, 3), by matrices, joint after joint."""
    arm = WORLD.grid_arm(GROUPS)
    found = np.empty((len(rows), len(arm.group_links), 3))
    for number, row in enumerate(rows):
        frames = [np.eye(4)]
        for origin, axis, angle in zip(arm.origins, arm.axes, row, strict=True):
            cross = np.cross(np.eye(3), axis)
            turn = np.eye(4)
            turn[:3, :3] += np.sin(angle) * cross + (1.0 - np.cos(angle)) * cross @ cross
            frames.append(frames[-1] @ origin @ turn)
        for group, (sphere, link) in enumerate(zip(arm.group_spheres_m, arm.group_links, strict=True)):
            found[number, group] = (frames[link] @ [*sphere[:3], 1.0])[:3]
    return found


def trilinear(values, place):
    """Values (X, Y, Z) at a place in voxels, by the eight voxels about it."""
    middle = np.clip(place - 0.5, 0.0, np.array(values.shape) - 1.001)
    first = np.floor(middle).astype(int)
    total = 0.0
    for corner in np.ndindex(2, 2, 2):
        weight = np.prod(np.where(np.array(corner) == 1, middle - first, 1.0 - (middle - first)))
        total += weight * values[tuple(first + corner)]
    return total


def test_each_group_is_told_its_margin_what_is_not_seen_free_and_how_deep_it_lies():
    arm, image, rows = WORLD.grid_arm(GROUPS), pictures(1)[0], configurations(3)
    lookups = SpaceLookups(WORLD, GROUPS)
    read = lookups(torch.tensor(WORLD.sensor.to_network(image[None])), rows[None])
    read = read.view(3, lookups.groups, 4).numpy()
    code = image[..., 1].astype(float)
    behind = (code > 0) & (code < min(arm.no_reading, arm.out_of_view))
    fields = [image[..., 0] * arm.distance_step_m, (code > 0).astype(float), np.where(behind, code / 255, 0)]
    places = (centres_m(rows.numpy()) - arm.low_m) / arm.voxel_m
    for number in range(3):
        for group in range(lookups.groups):
            near, unseen, depth = (trilinear(field, places[number, group]) for field in fields)
            margin = near - arm.group_spheres_m[group, 3]
            wanted = [margin / 0.1, np.tanh(margin / 0.03), unseen, depth]
            np.testing.assert_allclose(read[number, group], wanted, atol=2e-3)
    assert np.ptp(read, axis=(0, 1)).min() > 0.1


def test_the_reader_sees_in_each_ones_picture_what_the_lookups_see():
    images, rows, ids = pictures(), configurations(5), torch.tensor([1, 0, 0, 1, 1])
    lookups = SpaceLookups(WORLD, GROUPS)
    shown = torch.tensor(WORLD.sensor.to_network(images))
    both = lookups(shown, rows.expand(2, -1, -1))
    found = SpaceReader(lookups, torch.tensor(images))(ids, rows)
    torch.testing.assert_close(found, both[ids, torch.arange(5)], atol=1e-4, rtol=0.0)
    assert found.shape == (5, lookups.values)


def test_the_readers_derivative_and_its_derivative_are_those_of_finite_differences():
    read = SpaceReader(SpaceLookups(WORLD, GROUPS), torch.tensor(pictures(1))).double()
    rows, ids = configurations(2).double().requires_grad_(), torch.tensor([0, 0])
    see = lambda q: read(ids, q).square().mean(dim=1)  # noqa: E731
    assert torch.autograd.gradcheck(see, rows, eps=1e-7, atol=1e-4)
    assert torch.autograd.gradgradcheck(see, rows, eps=1e-7, atol=1e-3)


def test_the_world_decides_which_of_the_look_ups_there_are():
    both = LookupConfig(points_per_link=4, groups=GROUPS)
    plane = PlanarWorld(TWO_LINK, Camera())
    assert isinstance(make_lookups(both, WORLD), SpaceLookups)
    assert make_lookups(both, plane).values == 2 * 4 * 3
    assert make_lookups(LookupConfig(points_per_link=4), WORLD) is None
    assert make_lookups(LookupConfig(groups=GROUPS), plane) is None
    scenes = Scenes(WORLD, torch.tensor(pictures(1)))
    assert isinstance(make_reader(both, scenes), SpaceReader)
    assert make_reader(LookupConfig(points_per_link=4), scenes) is None
    with pytest.raises(ConfigError, match="need the pictures"):
        make_reader(LookupConfig(groups=GROUPS), None)
