"""Signed distances against dense samples of surfaces, and against distances told by hand."""

import numpy as np
import pytest

from cspace.worlds.spatial.bodies import distance_m
from cspace.worlds.spatial.obstacles import Box, Cylinder, Obstacles
from cspace.worlds.spatial.poses import HERE, make_pose, pose_of, turned

TURN = make_pose(turned(0.7, -0.5, 0.3), (0.4, -0.1, 0.5))
BOX = Box(pose_of(TURN), (0.3, 0.1, 0.2))
CYLINDER = Cylinder(pose_of(TURN), 0.15, 0.25)


def grid(*sides, step=0.005):
    axes = [np.linspace(-side, side, int(2 * side / step) + 1) for side in sides]
    return np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, len(sides))


def box_surface():
    faces = []
    for axis in range(3):
        others = [one for one in range(3) if one != axis]
        flat = grid(*(BOX.half_m[one] for one in others))
        for side in (-1, 1):
            points = np.empty((len(flat), 3))
            points[:, others], points[:, axis] = flat, side * BOX.half_m[axis]
            faces.append(points)
    return np.concatenate(faces)


def cylinder_surface():
    radius, half = CYLINDER.radius_m, CYLINDER.half_length_m
    angles, heights = np.linspace(0, 2 * np.pi, 200), np.linspace(-half, half, 101)
    angle, height = (one.ravel() for one in np.meshgrid(angles, heights))
    side = np.stack((radius * np.cos(angle), radius * np.sin(angle), height), axis=-1)
    disc = grid(radius, radius)
    disc = disc[np.hypot(*disc.T) <= radius]
    caps = [np.column_stack((disc, np.full(len(disc), z))) for z in (-half, half)]
    return np.concatenate((side, *caps))


def within_box(local):
    return (np.abs(local) < BOX.half_m).all(axis=1)


def within_cylinder(local):
    round_ = np.hypot(local[:, 0], local[:, 1]) < CYLINDER.radius_m
    return round_ & (np.abs(local[:, 2]) < CYLINDER.half_length_m)


@pytest.mark.parametrize(
    ("obstacles", "surface", "within"),
    [
        (Obstacles((BOX,)), box_surface, within_box),
        (Obstacles((), (CYLINDER,)), cylinder_surface, within_cylinder),
    ],
    ids=["box", "cylinder"],
)
def test_distances_are_those_to_a_densely_sampled_surface(obstacles, surface, within):
    local = np.random.default_rng(1).uniform(-0.6, 0.6, (400, 3))
    local[:200] *= 0.4
    inside, samples = within(local), surface()
    nearest = np.array([np.sqrt(((samples - point) ** 2).sum(axis=1).min()) for point in local])
    found = distance_m(obstacles, local @ TURN[:3, :3].T + TURN[:3, 3])
    assert 50 < inside.sum() < 350
    np.testing.assert_array_equal(found < 0.0, inside)
    np.testing.assert_allclose(np.abs(found), nearest, atol=0.003)
    assert (nearest >= np.abs(found) - 1e-4).all(), "samples are no nearer than the surface"


def test_distances_by_hand():
    box, cylinder = Obstacles((Box(HERE, (1.0, 2.0, 3.0)),)), Obstacles((), (Cylinder(HERE, 1.0, 2.0),))
    points = [(0, 0, 0), (4, 0, 0), (4, 6, 3), (4, 5, 7), (0.5, 1.9, 0)]
    np.testing.assert_allclose(distance_m(box, points), [-1, 3, 5, np.sqrt(34), -0.1], atol=1e-12)
    points = [(0, 0, 0), (0, 3, 0), (0, 0, 5), (0, 4, 6), (0, 0, 1.8)]
    np.testing.assert_allclose(distance_m(cylinder, points), [-1, 2, 3, 5, -0.2], atol=1e-12)
