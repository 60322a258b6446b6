"""The spatial world on flat axes: seen from the side, x to the right and z up, or from above."""

from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial import ConvexHull

from cspace.worlds.spatial.obstacles.shapes import Box, Cylinder, Obstacles
from cspace.worlds.spatial.robot.arm import SerialArm
from cspace.worlds.spatial.seeing.grid_box import GridBox
from cspace.worlds.spatial.seeing.sight import FREE
from cspace.worlds.spatial.seeing.surface_patches import DISTANCE_STEP_M

# Which coordinates are across and up.
SIDE, ABOVE = (0, 2), (0, 1)
_ROUND = 24
_SURFACE = (0.77, 0.19, 0.19)


def draw_obstacles(axes: Any, obstacles: Obstacles, colour: str, plane: tuple[int, int] = SIDE) -> None:
    """The outlines of obstacles on axes of matplotlib."""
    shapes: tuple[Box | Cylinder, ...] = (*obstacles.boxes, *obstacles.cylinders)
    for one in shapes:
        corners = _corners(one)[:, plane]
        outline = corners[ConvexHull(corners).vertices]
        axes.fill(*outline.T, facecolor=colour, edgecolor="black", linewidth=0.4, alpha=0.35)
    axes.set_aspect("equal")
    axes.set_xlabel(f"{'xyz'[plane[0]]} [m]")
    axes.set_ylabel(f"{'xyz'[plane[1]]} [m]")


def draw_seen(axes: Any, observed: NDArray[np.uint8], grid: GridBox) -> None:
    """An array (X, Y, Z, 2) from the side: surfaces that are seen in red, grey as far as space is unseen."""
    surface = observed[..., 0].min(axis=1) * DISTANCE_STEP_M < grid.voxel_m / 2.0
    unseen = (observed[..., 1] != FREE).mean(axis=1)
    shown = np.repeat(1.0 - 0.6 * unseen[..., None], 3, axis=2)
    shown[surface] = _SURFACE
    (left, _, low), (right, _, high) = grid.low_m, grid.high_m
    axes.imshow(shown.transpose(1, 0, 2), extent=(left, right, low, high), origin="lower")
    axes.set(xlabel="x [m]", ylabel="z [m]")


def draw_arm(
    axes: Any,
    arm: SerialArm,
    configuration: ArrayLike,
    colour: str,
    order: int,
    plane: tuple[int, int] = SIDE,
) -> None:
    """An arm's spheres, and the line through its joints, on axes of matplotlib."""
    rows = np.atleast_2d(np.asarray(configuration, dtype=np.float64))
    centres, radii = arm.sphere_centres_m(rows)[0][:, plane], arm.spheres_m()[:, 3]
    angles = np.linspace(0.0, 2.0 * np.pi, _ROUND)
    ring = np.stack([np.cos(angles), np.sin(angles)], axis=1)
    for centre, radius in zip(centres, radii, strict=True):
        axes.fill(*(centre + radius * ring).T, color=colour, alpha=0.15, linewidth=0, zorder=order)
    axes.plot(*arm.joint_positions_m(rows)[0][:, plane].T, color=colour, linewidth=1.2, zorder=order)


def _corners(shape: Box | Cylinder) -> NDArray[np.float64]:
    """(n, 3) m, whose hull is the shape's on any plane; of a cylinder's circles some points."""
    pose = np.asarray(shape.pose)
    if isinstance(shape, Box):
        signs = np.stack(np.meshgrid(*[(-1.0, 1.0)] * 3), axis=-1).reshape(-1, 3)
        own = signs * np.asarray(shape.half_m)
    else:
        angles = np.linspace(0.0, 2.0 * np.pi, _ROUND, endpoint=False)
        circle = shape.radius_m * np.stack([np.cos(angles), np.sin(angles)], axis=1)
        ends = (-shape.half_length_m, shape.half_length_m)
        own = np.concatenate([np.column_stack([circle, np.full(_ROUND, end)]) for end in ends])
    return np.asarray(own @ pose[:3, :3].T + pose[:3, 3])
