"""Forward kinematics and self-collision of a serial arm, by spheres: kernels for one state and for batches.

What is ``_into`` fills arrays that it is given and allocates nothing.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from cspace.kernel_cache import njit
from cspace.worlds.spatial.robot.arm import SerialArm


class ArmArrays(NamedTuple):
    """A serial arm of d joints, S spheres, P parts and K pairs as the kernels take it.

    Attributes:
        origins: (d, 4, 4) joints' frames in those of the links before them.
        axes: (d, 3) unit vectors.
        links: (S,) the link of each sphere.
        centres: (S, 3) in the link's frame, m.
        radii: (S,) m.
        ranges: (P, 2) first sphere of each part, and the one after its last.
        bound_links: (P,) the link of each part.
        bound_centres: (P, 3) of a sphere round the part, in the link's frame, m.
        bound_radii: (P,) m.
        pairs: (K, 2) parts that can touch.
    """

    origins: NDArray[np.float64]
    axes: NDArray[np.float64]
    links: NDArray[np.int64]
    centres: NDArray[np.float64]
    radii: NDArray[np.float64]
    ranges: NDArray[np.int64]
    bound_links: NDArray[np.int64]
    bound_centres: NDArray[np.float64]
    bound_radii: NDArray[np.float64]
    pairs: NDArray[np.int64]


def arm_arrays(arm: SerialArm) -> ArmArrays:
    """The arrays of an arm."""
    spheres = arm.spheres_m()
    counts = np.asarray([len(part.spheres_m) for part in arm.parts], dtype=np.int64)
    ends = np.cumsum(counts)
    numbers = {part.name: index for index, part in enumerate(arm.parts)}
    pairs = [(numbers[first], numbers[second]) for first, second in arm.touching]
    bounds = [_bound(np.asarray(part.spheres_m)) for part in arm.parts]
    return ArmArrays(
        origins=np.stack([joint.origin.matrix() for joint in arm.joints]),
        axes=np.asarray([joint.axis for joint in arm.joints]),
        links=arm.sphere_links(),
        centres=np.ascontiguousarray(spheres[:, :3]),
        radii=np.ascontiguousarray(spheres[:, 3]),
        ranges=np.stack([ends - counts, ends], axis=1),
        bound_links=np.asarray([part.link for part in arm.parts], dtype=np.int64),
        bound_centres=np.asarray([centre for centre, _ in bounds]).reshape(-1, 3),
        bound_radii=np.asarray([radius for _, radius in bounds], dtype=np.float64),
        pairs=np.asarray(pairs, dtype=np.int64).reshape(-1, 2),
    )


def _bound(spheres: NDArray[np.float64]) -> tuple[NDArray[np.float64], float]:
    centres, radii = spheres[:, :3], spheres[:, 3:]
    middle = ((centres - radii).min(axis=0) + (centres + radii).max(axis=0)) / 2.0
    return middle, float((np.linalg.norm(centres - middle, axis=1) + radii[:, 0]).max())


@njit(cache=True, nogil=True)
def link_frames_into(q, origins, axes, frames):  # type: ignore[no-untyped-def]
    """Forward kinematics of one configuration (d,): the links' frames, (d + 1, 4, 4)."""
    for row in range(4):
        for column in range(4):
            frames[0, row, column] = 1.0 if row == column else 0.0
    for joint in range(q.shape[0]):
        x, y, z = axes[joint, 0], axes[joint, 1], axes[joint, 2]
        c, s = np.cos(q[joint]), np.sin(q[joint])
        v = 1.0 - c
        before, after, origin = frames[joint], frames[joint + 1], origins[joint]
        for row in range(3):
            a, b, e = before[row, 0], before[row, 1], before[row, 2]
            i = a * origin[0, 0] + b * origin[1, 0] + e * origin[2, 0]
            j = a * origin[0, 1] + b * origin[1, 1] + e * origin[2, 1]
            k = a * origin[0, 2] + b * origin[1, 2] + e * origin[2, 2]
            after[row, 3] = a * origin[0, 3] + b * origin[1, 3] + e * origin[2, 3] + before[row, 3]
            after[row, 0] = i * (x * x * v + c) + j * (x * y * v + z * s) + k * (x * z * v - y * s)
            after[row, 1] = i * (x * y * v - z * s) + j * (y * y * v + c) + k * (y * z * v + x * s)
            after[row, 2] = i * (x * z * v + y * s) + j * (y * z * v - x * s) + k * (z * z * v + c)
        for column in range(4):
            after[3, column] = 1.0 if column == 3 else 0.0


@njit(cache=True, nogil=True)
def points_into(frames, links, points, out):  # type: ignore[no-untyped-def]
    """Points (S, 3) of the links that they are fixed to, in the base's frame, (S, 3) m."""
    for index in range(points.shape[0]):
        frame = frames[links[index]]
        x, y, z = points[index, 0], points[index, 1], points[index, 2]
        for row in range(3):
            out[index, row] = frame[row, 0] * x + frame[row, 1] * y + frame[row, 2] * z + frame[row, 3]


@njit(cache=True, nogil=True)
def self_distance(centres, bounds, arm):  # type: ignore[no-untyped-def]
    """Signed distance of the closest spheres of parts that can touch, m; inf where none can.

    ``centres`` (S, 3) and ``bounds`` (P, 3) are in the base's frame.
    """
    least = np.inf
    for pair in range(arm.pairs.shape[0]):
        i, j = arm.pairs[pair, 0], arm.pairs[pair, 1]
        if _gap(bounds, arm.bound_radii, i, bounds, arm.bound_radii, j) >= least:
            continue
        for first in range(arm.ranges[i, 0], arm.ranges[i, 1]):
            if _gap(centres, arm.radii, first, bounds, arm.bound_radii, j) >= least:
                continue
            for second in range(arm.ranges[j, 0], arm.ranges[j, 1]):
                least = min(least, _gap(centres, arm.radii, first, centres, arm.radii, second))
    return least


@njit(cache=True, nogil=True)
def _gap(first, first_radii, i, second, second_radii, j):  # type: ignore[no-untyped-def]
    x, y, z = first[i, 0] - second[j, 0], first[i, 1] - second[j, 1], first[i, 2] - second[j, 2]
    return np.sqrt(x * x + y * y + z * z) - first_radii[i] - second_radii[j]


@njit(cache=True, nogil=True)
def link_frames_batch(q, origins, axes):  # type: ignore[no-untyped-def]
    """Forward kinematics: (N, d) rad to the links' frames, (N, d + 1, 4, 4) m."""
    out = np.empty((q.shape[0], q.shape[1] + 1, 4, 4))
    for row in range(q.shape[0]):
        link_frames_into(q[row], origins, axes, out[row])
    return out


@njit(cache=True, nogil=True)
def sphere_centres_batch(q, arm):  # type: ignore[no-untyped-def]
    """Forward kinematics: (N, d) rad to the spheres' centres in the base's frame, (N, S, 3) m."""
    out = np.empty((q.shape[0], arm.centres.shape[0], 3))
    frames = np.empty((q.shape[1] + 1, 4, 4))
    for row in range(q.shape[0]):
        link_frames_into(q[row], arm.origins, arm.axes, frames)
        points_into(frames, arm.links, arm.centres, out[row])
    return out


@njit(cache=True, nogil=True)
def self_distance_batch(q, arm):  # type: ignore[no-untyped-def]
    """Signed distance of the closest spheres of parts that can touch, for (N, d) rad, (N,) m."""
    out = np.empty(q.shape[0])
    frames = np.empty((q.shape[1] + 1, 4, 4))
    centres, bounds = np.empty(arm.centres.shape), np.empty(arm.bound_centres.shape)
    for row in range(q.shape[0]):
        link_frames_into(q[row], arm.origins, arm.axes, frames)
        points_into(frames, arm.links, arm.centres, centres)
        points_into(frames, arm.bound_links, arm.bound_centres, bounds)
        out[row] = self_distance(centres, bounds, arm)
    return out
