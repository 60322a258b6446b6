"""Depth pictures of a scene: exact ones by ray casting, and the noise of depth cameras."""

from collections.abc import Callable

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import ndimage

from cspace.kernel_cache import njit
from cspace.worlds.spatial.camera import DepthCamera
from cspace.worlds.spatial.obstacles import Obstacles

Depth = NDArray[np.float32]
MAX_RANGE_M = 4.0
# Nearer than this a shape's window is the whole picture.
_NEAR_M = 1e-3
_TINY = 1e-12


def render_depth(
    obstacles: Obstacles,
    camera: DepthCamera,
    spheres: ArrayLike | None = None,
    max_range_m: float = MAX_RANGE_M,
) -> Depth:
    """The exact depths (H, W) m, 0 where nothing is within range; a robot's spheres (S, 4) m in the base."""
    arrays = obstacles.arrays
    robot = np.zeros((0, 4)) if spheres is None else np.asarray(spheres, dtype=np.float64).reshape(-1, 4)
    intrinsics = (camera.fx, camera.fy, camera.cx, camera.cy)
    depth = np.full(camera.picture_shape, np.inf)
    _cast(depth, intrinsics, camera.matrix, arrays.boxes, arrays.cylinders, robot)
    return np.where(depth <= max_range_m, depth, 0.0).astype(np.float32)


@njit(cache=True, nogil=True, error_model="numpy")
def _cast(depth, intrinsics, pose, boxes, cylinders, spheres):  # type: ignore[no-untyped-def]
    for index in range(boxes.shape[0]):
        _cast_box(depth, intrinsics, pose, boxes[index])
    for index in range(cylinders.shape[0]):
        _cast_cylinder(depth, intrinsics, pose, cylinders[index])
    for index in range(spheres.shape[0]):
        _cast_sphere(depth, intrinsics, pose, spheres[index])


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
def _cast_sphere(depth, intrinsics, pose, sphere):  # type: ignore[no-untyped-def]
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
                depth[v, u] = enter


# The formulae have poles at right angles; 85 degrees is about what a camera still reads.
_STEEPEST_RAD = np.radians(85.0)
# From where the angle adds to the axial noise (Nguyen, 60 degrees).
_STEEP_RAD = np.radians(60.0)
# Of a picture's side.
_LARGEST_HOLE = 0.65


# Shares of the pixels without a reading: beside depths that jump by so much, and anywhere.
_JUMP_M, _LOST_AT_JUMPS, _LOST_ANYWHERE = 0.03, 0.4, 0.002
_CROSS = ndimage.generate_binary_structure(2, 1)


def _lost(rng: np.random.Generator, depth_m: Depth) -> NDArray[np.bool_]:
    """Which pixels of an exact picture (H, W) m lose their reading; what reads nothing is infinitely far."""
    far = np.where(depth_m > 0.0, depth_m, np.inf)
    high = ndimage.maximum_filter(far, footprint=_CROSS, mode="nearest")
    low = ndimage.minimum_filter(far, footprint=_CROSS, mode="nearest")
    with np.errstate(invalid="ignore"):
        jumps = (high - far >= _JUMP_M) | (far - low >= _JUMP_M)
    shares = np.where(jumps & np.isfinite(far), _LOST_AT_JUMPS, _LOST_ANYWHERE)
    return np.asarray(rng.random(depth_m.shape) < shares)


def structured_light(rng: np.random.Generator, depth_m: Depth, camera: DepthCamera) -> Depth:
    """Axial and lateral noise of the first Kinect: it grows with the depth and the surface's angle."""
    angle = np.minimum(incidence_rad(depth_m, camera), _STEEPEST_RAD)
    lost = _lost(rng, depth_m)
    # In the picture, pixels (Nguyen, equation 3).
    moved = shifted(rng, depth_m, 0.8 + 0.035 * angle / (np.pi / 2.0 - angle))
    return _read(moved + rng.normal(size=depth_m.shape) * axial_sigma_m(moved, angle), moved, lost)


# Of the sensor with disparities, whatever the picture's size: focal length in pixels, baseline between
# projector and sensor in m, parts of a pixel that it reads, sigma in these, and that of the place in pixels.
_FOCAL_PX, _BASELINE_M, _PARTS, _SIGMA_PARTS, _LATERAL_PX = 480.0, 0.075, 8, 1.0 / 6.0, 0.5


def disparity(rng: np.random.Generator, depth_m: Depth, camera: DepthCamera) -> Depth:
    """The hard case: a depth that is read from a disparity in whole eighths of a pixel."""
    del camera
    lost = _lost(rng, depth_m)
    moved = shifted(rng, depth_m, np.full(depth_m.shape, _LATERAL_PX))
    scale = _FOCAL_PX * _BASELINE_M * _PARTS
    exact = np.divide(scale, moved, out=np.zeros(moved.shape), where=moved > 0.0)
    whole = np.floor(exact + rng.normal(size=depth_m.shape) * _SIGMA_PARTS + 0.5)
    read = np.divide(scale, whole, out=np.zeros(moved.shape), where=whole >= 1.0)
    return _read(read, moved, lost)


# Of a stereo camera: f in pixels, B in m, s of the disparity in pixels.
_STEREO_FOCAL_PX, _STEREO_BASELINE_M, _STEREO_SIGMA_PX = 424.0, 0.05, 0.08
_KERNEL = np.exp(-0.5 * np.arange(-3, 4) ** 2)
# By which a Gaussian filter of a pixel keeps the variance of white noise.
_WHITE_GAIN = _KERNEL.sum() ** 2 / (_KERNEL**2).sum()


def stereo(rng: np.random.Generator, depth_m: Depth, camera: DepthCamera) -> Depth:
    """A stereo camera: a sigma of z^2 s / (f B), whose errors are smooth over a pixel."""
    del camera
    lost = _lost(rng, depth_m)
    white = rng.normal(size=depth_m.shape)
    errors = ndimage.gaussian_filter(white, 1.0, mode="wrap", truncate=3.0) * _WHITE_GAIN
    sigma = depth_m.astype(np.float64) ** 2 * _STEREO_SIGMA_PX / (_STEREO_FOCAL_PX * _STEREO_BASELINE_M)
    return _read(depth_m + errors * sigma, depth_m, lost)


Noise = Callable[[np.random.Generator, Depth, DepthCamera], Depth]
# By the names that sensors have for them: an exact depth picture (H, W) m as the camera would read it.
NOISE_MODELS: dict[str, Noise] = {
    "structured_light": structured_light,
    "disparity": disparity,
    "stereo": stereo,
}


def axial_sigma_m(depth_m: NDArray[np.floating], angle_rad: NDArray[np.floating]) -> NDArray[np.float64]:
    """Sigma along the optical axis, m (Nguyen, equations 1 and 2)."""
    depth = np.maximum(np.asarray(depth_m, dtype=np.float64), 0.1)
    angle = np.asarray(angle_rad, dtype=np.float64)
    level = 0.0012 + 0.0019 * (depth - 0.4) ** 2
    steep = 0.0001 / np.sqrt(depth) * angle**2 / (np.pi / 2.0 - angle) ** 2
    return np.asarray(level + np.where(angle >= _STEEP_RAD, steep, 0.0))


def incidence_rad(depth_m: Depth, camera: DepthCamera) -> NDArray[np.float64]:
    """Angle between each pixel's ray and the surface's normal, (H, W), from the nearer of both neighbours."""
    rays = camera.rays()
    read = np.isfinite(depth_m) & (depth_m > 0.0)
    points = rays * np.where(read, depth_m, np.nan)[..., None]
    normal = np.cross(_slope(points, 1), _slope(points, 0))
    lengths = np.linalg.norm(normal, axis=-1) * np.linalg.norm(rays, axis=-1)
    facing = np.abs(np.einsum("hwk,hwk->hw", normal, rays))
    cosine = np.divide(facing, lengths, out=np.ones(depth_m.shape), where=lengths > 0.0)
    return np.asarray(np.arccos(np.clip(cosine, 0.0, 1.0)))


def shifted(rng: np.random.Generator, depth_m: Depth, sigma_px: NDArray[np.float64]) -> Depth:
    """Every pixel reads the pixel nearest to a place that is off by a normal draw in both directions."""
    height, width = depth_m.shape
    down, across = np.rint(rng.normal(size=(2, height, width)) * sigma_px).astype(np.int64)
    rows = np.clip(np.arange(height)[:, None] + down, 0, height - 1)
    columns = np.clip(np.arange(width)[None, :] + across, 0, width - 1)
    return np.asarray(depth_m[rows, columns])


def _read(read_m: NDArray[np.floating], exact_m: Depth, lost: NDArray[np.bool_]) -> Depth:
    """What remains: nothing where nothing was read before, or a noise led behind the camera."""
    kept = (exact_m > 0.0) & (read_m > 0.0) & ~lost
    return np.where(kept, read_m, 0.0).astype(np.float32)


def _slope(points: NDArray[np.float64], axis: int) -> NDArray[np.float64]:
    """The step (H, W, 3) to that neighbour at which the depth changes least; 0 where none is read."""
    steps = np.diff(points, axis=axis)
    none = np.full_like(np.take(points, [0], axis=axis), np.nan)
    after, before = np.concatenate((steps, none), axis), np.concatenate((none, steps), axis)
    change_after, change_before = (np.abs(np.nan_to_num(one[..., 2], nan=np.inf)) for one in (after, before))
    return np.nan_to_num(np.where((change_after <= change_before)[..., None], after, before))


def holed(rng: np.random.Generator, depth_m: Depth) -> Depth:
    """A depth picture (H, W) m in which one to three rectangles read nothing, up to 0.65 of a side each."""
    found = depth_m.copy()
    for _ in range(int(rng.integers(1, 4))):
        sizes = [max(1, int(side * rng.uniform(0.1, _LARGEST_HOLE))) for side in depth_m.shape]
        row, column = (
            int(rng.integers(side - size + 1)) for side, size in zip(depth_m.shape, sizes, strict=True)
        )
        found[row : row + sizes[0], column : column + sizes[1]] = 0.0
    return found
