"""Rendering: obstacles and a robot's spheres to the depth picture of a camera, by casting a ray a pixel.

Each shape is looked for only in the window of the picture that it can be in. A camera within a shape does not
see it: only surfaces that face the camera are.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from cspace.kernel_cache import njit
from cspace.worlds.spatial.obstacles.shapes import Obstacles
from cspace.worlds.spatial.seeing.camera import DepthCamera

MAX_RANGE_M = 4.0
# Nearer than this a shape's window is the whole picture.
_NEAR_M = 1e-3
_TINY = 1e-12


@dataclass(frozen=True, slots=True, eq=False)
class DepthView:
    """What a camera sees.

    Args:
        depth_m: (H, W) float32 along the optical axis; 0 where nothing is within range.
        robot: (H, W) bool, which pixels show the robot.
    """

    depth_m: NDArray[np.float32]
    robot: NDArray[np.bool_]


def render_depth(
    obstacles: Obstacles,
    camera: DepthCamera,
    spheres: ArrayLike | None = None,
    max_range_m: float = MAX_RANGE_M,
) -> DepthView:
    """The exact depth picture, without noise.

    Args:
        obstacles: in the base frame.
        camera: with its pose.
        spheres: (S, 4) of the robot: x, y, z, radius in m in the base frame; None for no robot.
        max_range_m: depths above it are not read.
    """
    arrays = obstacles.arrays
    robot = np.zeros((0, 4)) if spheres is None else np.asarray(spheres, dtype=np.float64).reshape(-1, 4)
    intrinsics = (camera.fx, camera.fy, camera.cx, camera.cy)
    depth = np.full(camera.picture_shape, np.inf)
    shown = np.zeros(camera.picture_shape, dtype=np.bool_)
    _cast(depth, shown, intrinsics, camera.matrix, arrays.boxes, arrays.cylinders, robot)
    read = depth <= max_range_m
    return DepthView(np.where(read, depth, 0.0).astype(np.float32), shown & read)


@njit(cache=True, nogil=True, error_model="numpy")
def _cast(depth, shown, intrinsics, pose, boxes, cylinders, spheres):  # type: ignore[no-untyped-def]
    for index in range(boxes.shape[0]):
        _cast_box(depth, intrinsics, pose, boxes[index])
    for index in range(cylinders.shape[0]):
        _cast_cylinder(depth, intrinsics, pose, cylinders[index])
    for index in range(spheres.shape[0]):
        _cast_sphere(depth, shown, intrinsics, pose, spheres[index])


@njit(cache=True, nogil=True, error_model="numpy")
def _into_shape(pose, row, centre, origin, turn):  # type: ignore[no-untyped-def]
    """A shape's centre in the camera frame, the camera in the shape's, and the rotation between them."""
    for i in range(3):
        centre[i], origin[i] = 0.0, 0.0
        for k in range(3):
            gap = row[k] - pose[k, 3]
            centre[i] += pose[k, i] * gap
            origin[i] -= row[3 + 3 * k + i] * gap
        for j in range(3):
            turn[i, j] = 0.0
            for k in range(3):
                turn[i, j] += row[3 + 3 * k + i] * pose[k, j]


@njit(cache=True, nogil=True, error_model="numpy")
def _window(intrinsics, shape, centre, turn, ex, ey, ez):  # type: ignore[no-untyped-def]
    """First column, last, first row, last, where a box of such half sizes may be seen; none: last < first."""
    fx, fy, cx, cy = intrinsics
    height, width = shape
    left, right, top, bottom = np.inf, -np.inf, np.inf, -np.inf
    before, behind = False, False
    for corner in range(8):
        sx = ex if corner & 1 else -ex
        sy = ey if corner & 2 else -ey
        sz = ez if corner & 4 else -ez
        x = centre[0] + sx * turn[0, 0] + sy * turn[1, 0] + sz * turn[2, 0]
        y = centre[1] + sx * turn[0, 1] + sy * turn[1, 1] + sz * turn[2, 1]
        z = centre[2] + sx * turn[0, 2] + sy * turn[1, 2] + sz * turn[2, 2]
        if z <= _NEAR_M:
            behind = True
            continue
        before = True
        left, right = min(left, fx * x / z + cx), max(right, fx * x / z + cx)
        top, bottom = min(top, fy * y / z + cy), max(bottom, fy * y / z + cy)
    if behind:
        return (0, width - 1, 0, height - 1) if before else (0, -1, 0, -1)
    # Clipped before they become whole numbers, which far ones could not.
    left, top = min(max(left, 0.0), float(width)), min(max(top, 0.0), float(height))
    right, bottom = max(min(right, width - 1.0), -1.0), max(min(bottom, height - 1.0), -1.0)
    return int(np.ceil(left)), int(np.floor(right)), int(np.ceil(top)), int(np.floor(bottom))


@njit(cache=True, nogil=True, error_model="numpy")
def _cast_box(depth, intrinsics, pose, row):  # type: ignore[no-untyped-def]
    fx, fy, cx, cy = intrinsics
    centre, origin, turn = np.empty(3), np.empty(3), np.empty((3, 3))
    _into_shape(pose, row, centre, origin, turn)
    hx, hy, hz = row[12], row[13], row[14]
    first, last, top, bottom = _window(intrinsics, depth.shape, centre, turn, hx, hy, hz)
    for v in range(top, bottom + 1):
        y = (v - cy) / fy
        bx = turn[0, 1] * y + turn[0, 2]
        by = turn[1, 1] * y + turn[1, 2]
        bz = turn[2, 1] * y + turn[2, 2]
        for u in range(first, last + 1):
            x = (u - cx) / fx
            enter, leave = _slab(origin[0], turn[0, 0] * x + bx, hx)
            near, far = _slab(origin[1], turn[1, 0] * x + by, hy)
            enter, leave = max(enter, near), min(leave, far)
            near, far = _slab(origin[2], turn[2, 0] * x + bz, hz)
            enter, leave = max(enter, near), min(leave, far)
            if 0.0 < enter <= leave and enter < depth[v, u]:
                depth[v, u] = enter


@njit(cache=True, nogil=True, error_model="numpy")
def _slab(origin, step, half):  # type: ignore[no-untyped-def]
    """When a ray is between -half and half along one axis."""
    if abs(step) < _TINY:
        step = _TINY
    inverse = 1.0 / step
    one, other = (-half - origin) * inverse, (half - origin) * inverse
    return min(one, other), max(one, other)


@njit(cache=True, nogil=True, error_model="numpy")
def _cast_cylinder(depth, intrinsics, pose, row):  # type: ignore[no-untyped-def]
    fx, fy, cx, cy = intrinsics
    centre, origin, turn = np.empty(3), np.empty(3), np.empty((3, 3))
    _into_shape(pose, row, centre, origin, turn)
    radius, half = row[12], row[13]
    first, last, top, bottom = _window(intrinsics, depth.shape, centre, turn, radius, radius, half)
    outside = origin[0] * origin[0] + origin[1] * origin[1] - radius * radius
    for v in range(top, bottom + 1):
        y = (v - cy) / fy
        for u in range(first, last + 1):
            x = (u - cx) / fx
            dx = turn[0, 0] * x + turn[0, 1] * y + turn[0, 2]
            dy = turn[1, 0] * x + turn[1, 1] * y + turn[1, 2]
            dz = turn[2, 0] * x + turn[2, 1] * y + turn[2, 2]
            enter, leave = _slab(origin[2], dz, half)
            square = dx * dx + dy * dy
            if square > _TINY:
                middle = origin[0] * dx + origin[1] * dy
                inside = middle * middle - square * outside
                if inside < 0.0:
                    continue
                root = np.sqrt(inside)
                enter, leave = max(enter, (-middle - root) / square), min(leave, (-middle + root) / square)
            elif outside > 0.0:
                continue
            if 0.0 < enter <= leave and enter < depth[v, u]:
                depth[v, u] = enter


@njit(cache=True, nogil=True, error_model="numpy")
def _cast_sphere(depth, shown, intrinsics, pose, sphere):  # type: ignore[no-untyped-def]
    fx, fy, cx, cy = intrinsics
    centre, radius = np.zeros(3), sphere[3]
    for i in range(3):
        for k in range(3):
            centre[i] += pose[k, i] * (sphere[k] - pose[k, 3])
    first, last, top, bottom = _window(intrinsics, depth.shape, centre, np.eye(3), radius, radius, radius)
    outside = centre[0] ** 2 + centre[1] ** 2 + centre[2] ** 2 - radius * radius
    for v in range(top, bottom + 1):
        y = (v - cy) / fy
        for u in range(first, last + 1):
            x = (u - cx) / fx
            square = x * x + y * y + 1.0
            middle = centre[0] * x + centre[1] * y + centre[2]
            inside = middle * middle - square * outside
            if inside < 0.0:
                continue
            enter = (middle - np.sqrt(inside)) / square
            if 0.0 < enter < depth[v, u]:
                depth[v, u], shown[v, u] = enter, True
