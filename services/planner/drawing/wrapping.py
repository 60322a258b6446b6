"""Straight segments of the joint space as a flat plot needs them: repeated at seams, never across a plot."""

from itertools import product

import numpy as np
from numpy.typing import NDArray

from cspace.space import JointSpace

_SAME_RAD = 1e-9


def wrapped_segments(
    space: JointSpace,
    starts: NDArray[np.float64],
    ends: NDArray[np.float64],
    joints: tuple[int, int],
) -> NDArray[np.float64]:
    """Segments in the plane of two joints, with a shifted copy of each one that crosses a seam.

    Every copy is a straight line of the true length; what lies outside the joints' ranges is for the axes to
    clip.

    Args:
        space: the joint space.
        starts: (N, d) rad.
        ends: (N, d) rad.
        joints: which two make the plane.

    Returns:
        (M, 2, 2): M lines, two ends, two joints, rad.
    """
    plane = list(joints)
    first = space.wrap(starts)[:, plane]
    lines = np.stack([first, first + space.difference(starts, ends)[:, plane]], axis=1)
    # An end on a seam is on it at both sides, however its place was rounded.
    low, high = np.asarray(space.lower)[plane] - _SAME_RAD, np.asarray(space.upper)[plane] + _SAME_RAD
    turns = [(-1, 0, 1) if space.periodic[joint] else (0,) for joint in plane]
    copies = [lines + 2.0 * np.pi * np.array(turn) for turn in product(*turns)]
    seen = [copy[np.all((copy.max(axis=1) >= low) & (copy.min(axis=1) <= high), axis=-1)] for copy in copies]
    return np.concatenate(seen)


def poses_along(space: JointSpace, path: NDArray[np.float64], count: int) -> NDArray[np.float64]:
    """``count`` configurations along a path (k, d), ends included, at equal distances; (count, d) rad."""
    steps = space.difference(path[:-1], path[1:])
    travelled = np.concatenate([[0.0], np.cumsum(np.linalg.norm(steps, axis=-1))])
    unrolled = path[0] + np.concatenate([np.zeros((1, space.dim)), np.cumsum(steps, axis=0)])
    at = np.linspace(0.0, travelled[-1], count)
    columns = [np.interp(at, travelled, unrolled[:, joint]) for joint in range(space.dim)]
    return space.wrap(np.stack(columns, axis=-1))
