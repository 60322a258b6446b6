"""What depth pictures say about the space round an arm, in one array on a grid. Numpy alone.

The array is the picture that later stages take: how far each voxel is from the surfaces that are seen, and
whether it was seen free, lies behind a surface, or was not looked at.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from cspace.errors import ImageError
from cspace.view_file import MAX_PICTURES
from cspace.world import Between
from cspace.worlds.spatial.seeing.camera import MIN_SIDE, DepthCamera
from cspace.worlds.spatial.seeing.depth_picture import in_range, resize_depth, to_m
from cspace.worlds.spatial.seeing.grid_box import GridBox
from cspace.worlds.spatial.seeing.robot_pixels import check_picture, drop_robot
from cspace.worlds.spatial.seeing.sight import FREE, OUT_OF_VIEW, sight
from cspace.worlds.spatial.seeing.surface_patches import (
    DISTANCE_STEP_M,
    TRUNCATION_M,
    distance_codes,
    patches,
)

# Larger pictures are reduced to it, to the nearest readings of their cells.
MAX_USED_SIDE = 160


@dataclass(frozen=True, slots=True, eq=False)
class Known:
    """What an array says of points.

    Args:
        distance_m: (...) float32 to the nearest surface seen, at most :data:`TRUNCATION_M`.
        codes: (...) uint8, channel 1 of :func:`observe`.
    """

    distance_m: NDArray[np.float32]
    codes: NDArray[np.uint8]

    @property
    def unseen(self) -> NDArray[np.bool_]:
        """(...): no camera saw that it is free."""
        return np.asarray(self.codes != FREE)


def observe(
    pictures: Sequence[NDArray[np.uint16]],
    cameras: Sequence[DepthCamera],
    grid: GridBox,
    spheres: ArrayLike | None = None,
    *,
    arm_hides: bool = True,
    between: Between | None = None,
) -> NDArray[np.uint8]:
    """Fuse depth pictures of one scene.

    Args:
        pictures: one to four, each (H, W) uint16 mm along the optical axis; 0, and what no depth camera can
            read, is no reading (:func:`cspace.worlds.spatial.seeing.depth_picture.in_range`).
        cameras: one each.
        grid: of the array.
        spheres: (S, 4) that cover the arm as it stands, x, y, z, radius in m in the base frame; None where
            it is in no picture.
        arm_hides: as :func:`cspace.worlds.spatial.seeing.sight.sight` has it.
        between: called between parts of some ms; what it raises passes through.

    Returns:
        (X, Y, Z, 2) uint8. Channel 0 is the distance from a voxel's centre to the nearest surface seen, see
        :func:`distances_m`. Channel 1 is the least code over the cameras of
        :func:`cspace.worlds.spatial.seeing.sight.sight`: what one has seen free is free.

    Raises:
        ImageError: there are too few or too many pictures, not a camera each, or one does not fit its camera.
    """
    if not 1 <= len(pictures) <= MAX_PICTURES or len(pictures) != len(cameras):
        raise ImageError(
            "the depth pictures do not fit",
            expected=f"1 to {MAX_PICTURES} and a camera each",
            got=f"{len(pictures)} pictures, {len(cameras)} cameras",
        )
    return fused(
        [
            observe_one(picture, camera, grid, spheres, arm_hides=arm_hides, between=between)
            for picture, camera in zip(pictures, cameras, strict=True)
        ]
    )


def observe_one(
    picture: NDArray[np.uint16],
    camera: DepthCamera,
    grid: GridBox,
    spheres: ArrayLike | None = None,
    *,
    arm_hides: bool = True,
    between: Between | None = None,
) -> NDArray[np.uint8]:
    """:func:`observe` of one picture.

    Raises:
        ImageError: it does not fit its camera.
    """
    pause = between or (lambda: None)
    check_picture(picture, camera)
    smaller, camera = _reduced(np.where(in_range(picture), picture, np.uint16(0)), camera)
    pause()
    kept = drop_robot(smaller, camera, np.empty((0, 4)) if spheres is None else spheres, between=pause)
    surface_m = to_m(kept.depth_mm)
    shown = patches(surface_m, camera, grid)
    pause()
    away = distance_codes(shown, grid, pause)
    pause()
    known = sight(surface_m, kept.front_m, camera, grid, arm_hides=arm_hides)
    pause()
    return np.stack((away, known), axis=-1)


def fused(single: Sequence[NDArray[np.uint8]]) -> NDArray[np.uint8]:
    """What several pictures of one scene say together, each (X, Y, Z, 2)."""
    return np.asarray(np.minimum.reduce(list(single)))


def distances_m(observed: NDArray[np.uint8]) -> NDArray[np.float32]:
    """Of an array (..., 2), (...) m; :data:`TRUNCATION_M` stands for all that is farther."""
    return np.asarray(observed[..., 0] * np.float32(DISTANCE_STEP_M))


def lookup(observed: NDArray[np.uint8], grid: GridBox, points_m: ArrayLike) -> Known:
    """What an array (X, Y, Z, 2) says of points (..., 3) m in the base frame.

    Distances are trilinear between the centres of voxels, codes those of the voxel that a point is in.
    Outside of the grid all is unseen, and far from what is seen.
    """
    points = np.asarray(points_m)
    cell, inside, place = _cells(grid, points.reshape(-1, 3))
    flat = observed.reshape(-1)
    codes = np.where(inside, flat.take(2 * cell + 1), np.uint8(OUT_OF_VIEW))
    low, share, steps = [], [], []
    for axis, count in enumerate(grid.counts):
        middle = np.clip(place[axis] - np.float32(0.5), 0.0, np.float32(count - 1))
        first = np.minimum(middle.astype(np.intp), max(count - 2, 0))
        low.append(first)
        share.append(middle - first.astype(np.float32))
        steps.append(1 if count > 1 else 0)
    strides = 2 * np.array((grid.counts[1] * grid.counts[2], grid.counts[2], 1))
    start = low[0] * strides[0] + low[1] * strides[1] + low[2] * strides[2]
    x, y, z = (int(one) for one in strides * steps)

    def along_z(at: int) -> NDArray[np.float32]:
        one = flat.take(start + at).astype(np.float32)
        return np.asarray(one + share[2] * (flat.take(start + (at + z)).astype(np.float32) - one))

    def along_y(at: int) -> NDArray[np.float32]:
        one = along_z(at)
        return np.asarray(one + share[1] * (along_z(at + y) - one))

    near = along_y(0)
    near = (near + share[0] * (along_y(x) - near)) * np.float32(DISTANCE_STEP_M)
    distance = np.where(inside, near, np.float32(TRUNCATION_M))
    shape = points.shape[:-1]
    return Known(distance.reshape(shape), codes.reshape(shape))


def unseen_share(
    observed: NDArray[np.uint8], grid: GridBox, centres_m: ArrayLike, weights: ArrayLike
) -> NDArray[np.float64]:
    """Which share of an arm lies where no camera saw that it is free, (N,).

    Args:
        observed: (X, Y, Z, 2).
        grid: of it.
        centres_m: (N, S, 3) of the arm's spheres in the base frame.
        weights: (S,) of the spheres, such as their volumes; they need not sum to 1.
    """
    centres, weight = np.asarray(centres_m), np.asarray(weights, dtype=np.float64)
    cell, inside, _ = _cells(grid, centres.reshape(-1, 3))
    unseen = ~inside | (observed.reshape(-1).take(2 * cell + 1) != FREE)
    return np.asarray(unseen.reshape(centres.shape[:-1]) @ (weight / weight.sum()))


def _cells(
    grid: GridBox, points: NDArray[np.floating]
) -> tuple[NDArray[np.intp], NDArray[np.bool_], NDArray[np.float32]]:
    """The voxels that points (N, 3) are in: numbers, 0 outside of the grid; which are inside; and where.

    The last is (3, N) in voxels from the lowest corner.
    """
    place = ((points - np.array(grid.low_m)) / grid.voxel_m).astype(np.float32).T
    counts = np.array(grid.counts, dtype=np.float32)[:, None]
    inside = ((place >= 0.0) & (place < counts)).all(axis=0)
    place = np.where(inside, place, np.float32(0.0))
    x, y, z = place.astype(np.intp)
    return (x * grid.counts[1] + y) * grid.counts[2] + z, inside, place


def _reduced(picture: NDArray[np.uint16], camera: DepthCamera) -> tuple[NDArray[np.uint16], DepthCamera]:
    share = MAX_USED_SIDE / max(picture.shape)
    if share >= 1.0:
        return picture, camera
    height, width = (min(side, max(MIN_SIDE, int(side * share))) for side in picture.shape)
    smaller = resize_depth(picture, height, width).astype(np.uint16)
    return smaller, camera.resized(width, height)
