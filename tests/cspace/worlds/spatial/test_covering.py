"""Groups of an arm's spheres, each held by one."""

from functools import cache

import numpy as np
import pytest

from cspace.worlds.spatial.arm import grouped
from tests.cspace.worlds.spatial.test_robots import PANDA


@cache
def groups_of(count):
    return grouped(PANDA, count)


@pytest.mark.parametrize("count", [11, 96, 267])
def test_every_sphere_lies_in_its_group_s_which_holds_spheres_of_one_part(count):
    found, own = groups_of(count), PANDA.spheres_m()
    assert len(found.links) == len(found.spheres_m) == count
    assert np.array_equal(np.unique(found.groups), np.arange(count))
    assert np.array_equal(found.links[found.groups], PANDA.sphere_links())
    holding = found.spheres_m[found.groups]
    reach = np.linalg.norm(own[:, :3] - holding[:, :3], axis=1) + own[:, 3]
    assert (reach <= holding[:, 3] + 1e-9).all()
    parts = np.repeat(np.arange(len(PANDA.parts)), [len(part.spheres_m) for part in PANDA.parts])
    assert all(len(np.unique(parts[found.groups == group])) == 1 for group in range(count))


def test_more_groups_are_smaller_and_as_many_as_spheres_are_these():
    sizes = [groups_of(count).spheres_m[:, 3].max() for count in (11, 48, 96)]
    assert sizes[0] > sizes[1] > sizes[2]
    whole = groups_of(PANDA.sphere_count)
    assert np.allclose(whole.spheres_m[whole.groups], PANDA.spheres_m(), atol=1e-9)


def test_there_is_a_group_for_each_part_at_least_and_for_each_sphere_at_most():
    assert [len(groups_of(count).links) for count in (1, 10**6)] == [len(PANDA.parts), PANDA.sphere_count]
