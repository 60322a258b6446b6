from dataclasses import replace

import numpy as np
import pytest

from cspace.errors import ScenarioError
from cspace.worlds import usual_world
from cspace.worlds.spatial.sensor import MAX_VOXELS, grid_of, shoulder_reach_m
from tests.cspace.worlds.spatial.test_robots import PANDA


def test_the_pandas_grid_holds_all_that_it_can_touch_and_little_more():
    grid = grid_of(PANDA)
    assert grid.counts == (80, 80, 80)
    rows = np.random.default_rng(0).uniform(PANDA.space.lower, PANDA.space.upper, (2000, 7))
    centres, radii = PANDA.sphere_centres_m(rows), PANDA.spheres_m()[:, 3:]
    assert ((centres - radii).min(axis=(0, 1)) >= grid.low_m).all()
    assert ((centres + radii).max(axis=(0, 1)) <= grid.high_m).all()
    away = np.linalg.norm(centres - PANDA.joints[0].origin.xyz_m, axis=-1) + radii[:, 0]
    assert 0.97 * shoulder_reach_m(PANDA) < away.max() <= shoulder_reach_m(PANDA)


@pytest.mark.parametrize("size", np.arange(0.6, 3.0, 0.15))
def test_networks_can_halve_the_grid_of_an_arm_of_any_size_four_times(size):
    joints = tuple(replace(one, origin=moved(one.origin, size)) for one in PANDA.joints)
    world = usual_world(replace(PANDA, joints=joints, name="scaled"))
    assert all(count % 16 == 0 for count in world.sensor.grid.counts)
    assert np.prod(world.sensor.grid.counts) <= MAX_VOXELS
    assert world.grid_arm(50).voxel_m == world.sensor.grid.voxel_m
    odd = replace(world.sensor.grid, counts=(72, 80, 80))
    with pytest.raises(ScenarioError, match=r"multiples of 16.*got \(72, 80, 80\)"):
        replace(world, sensor=replace(world.sensor, grid=odd)).grid_arm(50)


def moved(origin, size):
    """A frame whose origin lies ``size`` times as far away."""
    return replace(origin, xyz_m=tuple(size * place for place in origin.xyz_m))
