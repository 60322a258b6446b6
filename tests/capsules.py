"""Distances of capsules in plain numpy, one pair at a time: what the kernels are held against."""

import itertools

import numpy as np
from numpy.typing import ArrayLike, NDArray

from cspace.worlds.planar.arm import PlanarArm

Point = NDArray[np.float64]


def gap_by_hand(tail: Point, head: Point, other_tail: Point, other_head: Point) -> float:
    """The least of a quadratic on the unit square: where it is flat, or on one of the four sides."""
    first, second, apart = head - tail, other_head - other_tail, other_tail - tail

    def gap(along: float, other: float) -> float:
        return float(np.linalg.norm(apart + other * second - along * first))

    gaps = []
    for end in (0.0, 1.0):
        path = apart + end * second
        gaps.append(gap(np.clip(np.dot(path, first) / np.dot(first, first), 0.0, 1.0), end))
        path = end * first - apart
        gaps.append(gap(end, np.clip(np.dot(path, second) / np.dot(second, second), 0.0, 1.0)))
    matrix = np.column_stack([first, -second])
    if abs(np.linalg.det(matrix)) > 1e-12:
        along, other = np.linalg.solve(matrix, apart)
        if 0.0 <= along <= 1.0 and 0.0 <= other <= 1.0:
            gaps.append(gap(along, other))
    return min(gaps)


def self_clearance_by_hand(robot: PlanarArm, q: ArrayLike) -> float:
    """Of the capsules of links that are not neighbours, m; inf where all are."""
    ends = robot.joint_positions_m(q)[0]
    gaps = [
        gap_by_hand(ends[one], ends[one + 1], ends[other], ends[other + 1])
        for one, other in itertools.combinations(range(robot.dim), 2)
        if other - one > 1
    ]
    return min(gaps, default=np.inf) - 2.0 * robot.half_width_m
