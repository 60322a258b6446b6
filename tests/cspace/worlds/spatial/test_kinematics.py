from math import pi

import numpy as np

from cspace.worlds.spatial.arm import Joint, Part, SerialArm
from cspace.worlds.spatial.collision import CollisionChecker
from cspace.worlds.spatial.kinematics import (
    arm_arrays,
    link_frames_into,
    sphere_centres_batch,
)
from cspace.worlds.spatial.obstacles import Obstacles
from cspace.worlds.spatial.poses import Frame
from tests.cspace.worlds.spatial.test_robots import VAMP as PANDA

SLANTED = SerialArm(
    "slanted",
    (
        Joint("one", Frame((0.1, -0.2, 0.3), (0.3, -1.1, 2.0)), (2 / 3, -1 / 3, 2 / 3)),
        Joint("two", Frame((-0.4, 0.2, 0.5), (-2.0, 0.7, 0.1)), (0.6, 0.0, -0.8)),
    ),
)


def test_kernels_give_what_numpy_gives() -> None:
    rng = np.random.default_rng(1)
    for arm in (PANDA, SLANTED):
        q = rng.uniform(-pi, pi, (50, arm.dim))
        arrays = arm_arrays(arm)
        frames = np.empty((len(q), arm.dim + 1, 4, 4))
        for row, found in zip(q, frames, strict=True):
            link_frames_into(row, arrays.origins, arrays.axes, found)
        np.testing.assert_allclose(frames, arm.link_frames(q), rtol=0.0, atol=1e-12)
    q = rng.uniform(-pi, pi, (50, 7))
    centres = sphere_centres_batch(q, arm_arrays(PANDA))
    np.testing.assert_allclose(centres, PANDA.sphere_centres_m(q), rtol=0.0, atol=1e-12)


def test_self_distance_is_that_of_the_closest_spheres_of_a_pair() -> None:
    rng = np.random.default_rng(2)
    q = rng.uniform(PANDA.space.lower, PANDA.space.upper, (200, 7))
    found = CollisionChecker(PANDA, Obstacles()).clearance(q)
    centres, radii = PANDA.sphere_centres_m(q), PANDA.spheres_m()[:, 3]
    gaps = np.linalg.norm(centres[:, :, None] - centres[:, None], axis=-1) - radii[:, None] - radii
    names = np.repeat([part.name for part in PANDA.parts], [len(part.spheres_m) for part in PANDA.parts])
    allowed = np.zeros((59, 59), dtype=bool)
    for first, second in PANDA.touching:
        allowed |= np.outer(names == first, names == second)
    expected = np.where(allowed, gaps, np.inf).min(axis=(1, 2))
    np.testing.assert_allclose(found, expected, atol=1e-12)
    assert (found < 0.0).any()
    assert (found > 0.0).any()


def test_spheres_of_two_parts_may_overlap_by_what_both_allow() -> None:
    def arm(*overlaps_m: float | None) -> SerialArm:
        sizes = zip(("upper", "lower"), (0.1, 0.2), overlaps_m, strict=True)
        parts = [
            Part(name, link, ((0.5, 0.0, 0.0, radius),), overlap)
            for link, (name, radius, overlap) in enumerate(sizes, 1)
        ]
        joints = (Joint("base"), Joint("elbow", Frame((1.0, 0.0, 0.0))))
        return SerialArm("folding", joints, tuple(parts), (("upper", "lower"),))

    # Their centres are 0.295 and 0.285 m apart, their radii 0.3 m together.
    q = np.array([[0.0, pi - 2.0 * np.arcsin(apart)] for apart in (0.295, 0.285)])
    for overlaps, found in (((0.004, 0.006), [0.005, -0.005]), ((0.004, None), [-0.005, -0.015])):
        allowed = arm(*overlaps)
        checker = CollisionChecker(allowed, Obstacles())
        np.testing.assert_allclose(checker.clearance(q), found, atol=1e-9)
        assert checker.valid_batch(q).tolist() == [one > 0.0 for one in found]
