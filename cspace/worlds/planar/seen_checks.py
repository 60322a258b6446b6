"""What a picture of the plane shows as discs, for checks that know the picture alone."""

import numpy as np
from numpy.typing import NDArray

from cspace.worlds.planar.planning.collision import CollisionChecker
from cspace.worlds.planar.scene import Scenario
from cspace.worlds.planar.world import PlanarWorld

# Of a pixel's side, that obstacles are taken to be larger; the most careful first.
MARGINS = (0.5, 0.0, -0.25)
# Of a pixel, from which on it counts as covered.
_COVERED = 0.25
# Blue of the picture where a pixel is wholly covered, and where it is not covered.
_GROUND = 255.0


def seen_checkers(
    world: PlanarWorld, picture: NDArray[np.uint8], ends: NDArray[np.float64]
) -> list[CollisionChecker]:
    """See :func:`cspace.worlds.seen_checkers`; covered pixels are discs of their area."""
    camera, arm = world.sensor, world.body
    # Red discs lie over the blue arm and the white ground.
    covered = 1.0 - picture[..., 2] / _GROUND
    rows, columns = np.nonzero(_outline(covered >= _COVERED))
    height, width = (side / camera.pixels for side in _sides(camera.extent_m))
    left, _, _, top = camera.extent_m
    places = np.stack([left + (columns + 0.5) * width, top - (rows + 0.5) * height], axis=1)
    radii = np.sqrt(covered[rows, columns] * width * height / np.pi)
    room = _distances(arm.joint_positions_m(ends), places) - arm.half_width_m
    found = []
    for margin in MARGINS:
        sizes = np.minimum(radii + margin * width, 0.99 * room)
        discs = np.column_stack([places, sizes])[sizes > 0.0]
        found.append(CollisionChecker(Scenario.from_array(arm, discs, camera)))
    return found


def _sides(extent_m: tuple[float, float, float, float]) -> tuple[float, float]:
    """Height and width, m."""
    left, right, bottom, top = extent_m
    return top - bottom, right - left


def _outline(covered: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Those that are not surrounded by others: an arm that touches an inner one touches these before."""
    framed = np.pad(covered, 1, constant_values=False)
    inner = framed[:-2, 1:-1] & framed[2:, 1:-1] & framed[1:-1, :-2] & framed[1:-1, 2:]
    return covered & ~inner


def _distances(joints: NDArray[np.float64], places: NDArray[np.float64]) -> NDArray[np.float64]:
    """Of places (n, 2) to the nearest of the arms' links (k, j, 2), (n,) m."""
    begins, ends = joints[:, :-1].reshape(-1, 2), joints[:, 1:].reshape(-1, 2)
    along = ends - begins
    apart = places[:, None] - begins
    shares = np.clip((apart * along).sum(axis=2) / (along * along).sum(axis=1), 0.0, 1.0)
    found: NDArray[np.float64] = np.linalg.norm(apart - shares[..., None] * along, axis=2).min(axis=1)
    return found
