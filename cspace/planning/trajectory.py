"""Trajectories: times along a path, within limits of velocity and acceleration.

The robot follows the path's straight edges and rounds its corners by parabolic blends, each at a constant
speed along the path (Kunz and Stilman, Turning Paths Into Trajectories Using Parabolic Blends, 2011). It
stops at a corner where no blend is free.
"""

from collections.abc import Callable

import numpy as np
from numpy.typing import ArrayLike, NDArray

from cspace.query import Trajectory
from cspace.space import JointSpace

Floats = NDArray[np.float64]
AreFree = Callable[[Floats], NDArray[np.bool_]]
# How far a blend may leave its corner, Euclidean, and the distance of the states by which it is checked.
TOLERANCE_RAD, CHECK_RAD = 0.1, 0.01
# Of an edge, what the blend at one of its ends takes at most: the speed changes on the rest.
_SHARE = 0.4
# So many sizes of a blend are tried, each half the one before.
_SIZES = 3
_SMALL = 1e-9


def timed(
    path: ArrayLike, space: JointSpace, velocity: ArrayLike, acceleration: ArrayLike, are_free: AreFree
) -> Trajectory:
    """The trajectory of a path (k, d) rad within limits (d,) of rad/s and rad/s^2.

    ``are_free``: which of (n, d) rad are, (n,); asked of the blends alone.
    """
    rows = np.asarray(path, dtype=np.float64)
    steps = space.difference(rows[:-1], rows[1:])
    steps = steps[np.linalg.norm(steps, axis=1) > _SMALL]
    if not len(steps):
        return Trajectory(np.zeros(1), rows[:1], np.zeros_like(rows[:1]))
    corners = rows[0] + np.concatenate([np.zeros_like(rows[:1]), np.cumsum(steps, axis=0)])
    lengths = np.linalg.norm(steps, axis=1)
    along = steps / lengths[:, None]
    turns = np.diff(along, axis=0)
    # Blends reach so far to either side of their corners.
    reach = np.zeros(len(corners))
    widest = 4.0 * TOLERANCE_RAD / np.maximum(np.linalg.norm(turns, axis=1), _SMALL)
    reach[1:-1] = np.minimum(_SHARE * np.minimum(lengths[:-1], lengths[1:]), widest)
    _shrink(reach, corners, along, space, are_free)
    straight = lengths - reach[:-1] - reach[1:]
    peaks, rates = _largest(velocity, along), _largest(acceleration, along)
    bends = np.sqrt(2.0 * reach[1:-1] * _largest(acceleration, turns))
    speeds = np.zeros(len(corners))
    speeds[1:-1] = np.minimum(bends, np.minimum(peaks[:-1], peaks[1:]))
    # What the edges before and behind can change.
    gains = 2.0 * rates * straight
    for k, gain in enumerate(gains):
        speeds[k + 1] = min(speeds[k + 1], np.sqrt(speeds[k] ** 2 + gain))
    for k, gain in reversed(list(enumerate(gains))):
        speeds[k] = min(speeds[k], np.sqrt(speeds[k + 1] ** 2 + gain))
    peaks = np.minimum(peaks, np.sqrt((speeds[:-1] ** 2 + speeds[1:] ** 2 + gains) / 2.0))
    return _points(corners, along, reach, speeds, peaks, rates)


def _shrink(reach: Floats, corners: Floats, along: Floats, space: JointSpace, are_free: AreFree) -> None:
    """Halve the blends that are not free; 0 where none of the sizes is."""
    left = np.arange(1, len(reach) - 1)
    for _ in range(_SIZES):
        if not len(left):
            return
        blends = []
        for k in left:
            shares = np.linspace(0.0, 1.0, max(2, int(np.ceil(2.0 * reach[k] / CHECK_RAD)) + 1))[:, None]
            turned = (2.0 * shares - 1.0) * along[k - 1] + shares**2 * (along[k] - along[k - 1])
            blends.append(corners[k] + reach[k] * turned)
        free = are_free(space.wrap(np.concatenate(blends)))
        begins = np.cumsum([0, *map(len, blends[:-1])])
        left = left[~np.logical_and.reduceat(free, begins)]
        reach[left] /= 2.0
    reach[left] = 0.0


def _largest(limits: ArrayLike, directions: Floats) -> Floats:
    """(n,): how far each direction (n, d) can be scaled within the joints' limits (d,)."""
    return np.asarray((np.asarray(limits) / np.maximum(np.abs(directions), _SMALL)).min(axis=1))


def _points(
    corners: Floats, along: Floats, reach: Floats, speeds: Floats, peaks: Floats, rates: Floats
) -> Trajectory:
    """Where the acceleration changes: each edge is sped up, kept and slowed down, then comes the blend."""
    spans, positions, velocities = [0.0], [corners[0]], [np.zeros_like(corners[0])]
    for k, way in enumerate(along):
        begin, end = corners[k] + reach[k] * way, corners[k + 1] - reach[k + 1] * way
        peak, ends = peaks[k], speeds[k : k + 2]
        faster, slower = (peak**2 - ends**2) / (2.0 * rates[k])
        kept = max(0.0, float(np.linalg.norm(end - begin)) - faster - slower)
        spans += [(peak - ends[0]) / rates[k], kept / peak, (peak - ends[1]) / rates[k]]
        positions += [begin + faster * way, begin + (faster + kept) * way, end]
        velocities += [peak * way, peak * way, ends[1] * way]
        if reach[k + 1] > 0.0:
            spans.append(2.0 * reach[k + 1] / ends[1])
            positions.append(corners[k + 1] + reach[k + 1] * along[k + 1])
            velocities.append(ends[1] * along[k + 1])
    lasting = np.asarray(spans) > _SMALL
    lasting[0] = True
    return Trajectory(np.cumsum(spans)[lasting], np.stack(positions)[lasting], np.stack(velocities)[lasting])
