"""Collision checks: one numba kernel, used for single states, batches and edges alike.

A configuration is free when the clearance between every link's capsule and every disc is above zero and every
limited joint is within its limits.
"""

from typing import Any

import numpy as np
from numba import njit
from numpy.typing import ArrayLike, NDArray

from cspace.errors import ScenarioError
from cspace.worlds.planar.scene import Scenario

TWO_PI = 2.0 * np.pi


@njit(cache=True, nogil=True)
def arm_clearance(q, links, half_width, discs):  # type: ignore[no-untyped-def]
    """Smallest distance between the arm's capsules and the discs, m; inf without discs."""
    clearance = np.inf
    x0, y0, heading = 0.0, 0.0, 0.0
    for joint in range(links.shape[0]):
        heading += q[joint]
        dx, dy = links[joint] * np.cos(heading), links[joint] * np.sin(heading)
        for disc in range(discs.shape[0]):
            px, py = discs[disc, 0] - x0, discs[disc, 1] - y0
            along = (px * dx + py * dy) / (dx * dx + dy * dy)
            along = min(1.0, max(0.0, along))
            gap = np.hypot(px - along * dx, py - along * dy) - discs[disc, 2] - half_width
            clearance = min(clearance, gap)
        x0 += dx
        y0 += dy
    return clearance


@njit(cache=True, nogil=True)
def arm_is_free(q, links, half_width, discs, lower, upper, periodic):  # type: ignore[no-untyped-def]
    """Whether one configuration (d,) is within its limits and clear of every disc."""
    for joint in range(links.shape[0]):
        if not periodic[joint] and not lower[joint] <= q[joint] <= upper[joint]:
            return False
    return arm_clearance(q, links, half_width, discs) > 0.0


@njit(cache=True, nogil=True)
def checked_edge(a, b, resolution, links, half_width, discs, lower, upper, periodic):  # type: ignore[no-untyped-def]
    """Whether the straight wrapped segment from ``a`` to ``b`` is free, and how many states were looked at.

    Both ends are included. Neighbouring states are at most ``resolution`` rad apart in every joint. They are
    looked at in the order of a bisection, which finds collisions sooner and changes no result.
    """
    dim = links.shape[0]
    step = np.empty(dim)
    longest = 0.0
    for joint in range(dim):
        step[joint] = b[joint] - a[joint]
        if periodic[joint]:
            step[joint] = (step[joint] + np.pi) % TWO_PI - np.pi
        longest = max(longest, abs(step[joint]))
    count = max(1, int(np.ceil(longest / resolution)))
    q = np.empty(dim)
    stride = 1
    while stride < count:
        stride *= 2
    first, looked = True, 0
    while stride >= 1:
        start, jump = (0, stride) if first else (stride, 2 * stride)
        for index in range(start, count + 1, jump):
            for joint in range(dim):
                q[joint] = a[joint] + step[joint] * index / count
            looked += 1
            if not arm_is_free(q, links, half_width, discs, lower, upper, periodic):
                return False, looked
        first = False
        stride //= 2
    for joint in range(dim):
        q[joint] = a[joint] + step[joint]
    return arm_is_free(q, links, half_width, discs, lower, upper, periodic), looked + 1


@njit(cache=True, nogil=True)
def edge_is_free(a, b, resolution, links, half_width, discs, lower, upper, periodic):  # type: ignore[no-untyped-def]
    """Whether the straight wrapped segment from ``a`` to ``b`` is free, both ends included."""
    return checked_edge(a, b, resolution, links, half_width, discs, lower, upper, periodic)[0]


@njit(cache=True, nogil=True)
def _clearance_batch(q, links, half_width, discs):  # type: ignore[no-untyped-def]
    out = np.empty(q.shape[0])
    for row in range(q.shape[0]):
        out[row] = arm_clearance(q[row], links, half_width, discs)
    return out


@njit(cache=True, nogil=True)
def _free_batch(q, links, half_width, discs, lower, upper, periodic):  # type: ignore[no-untyped-def]
    out = np.empty(q.shape[0], dtype=np.bool_)
    for row in range(q.shape[0]):
        out[row] = arm_is_free(q[row], links, half_width, discs, lower, upper, periodic)
    return out


@njit(cache=True, nogil=True)
def _edge_batch(a, b, resolution, links, half_width, discs, lower, upper, periodic):  # type: ignore[no-untyped-def]
    out = np.empty(a.shape[0], dtype=np.bool_)
    for row in range(a.shape[0]):
        out[row] = edge_is_free(a[row], b[row], resolution, links, half_width, discs, lower, upper, periodic)
    return out


class CollisionChecker:
    """Exact collision checks for one scenario.

    ``kernel_args`` are the arguments that the raw kernels :func:`arm_is_free` and :func:`edge_is_free` take
    after their own, for callbacks where a method call is too dear.
    """

    def __init__(self, scenario: Scenario) -> None:
        space = scenario.robot.space
        self.scenario = scenario
        self.kernel_args: tuple[Any, ...] = (
            np.asarray(scenario.robot.link_lengths_m, dtype=np.float64),
            float(scenario.robot.half_width_m),
            scenario.disc_array,
            np.asarray(space.lower, dtype=np.float64),
            np.asarray(space.upper, dtype=np.float64),
            np.asarray(space.periodic, dtype=np.bool_),
        )

    def valid(self, configuration: ArrayLike) -> bool:
        """Whether one configuration (d,) rad is free."""
        return bool(self.valid_batch(np.atleast_2d(np.asarray(configuration, dtype=np.float64)))[0])

    def valid_batch(self, configurations: ArrayLike) -> NDArray[np.bool_]:
        """Which of (N, d) rad are free, (N,)."""
        result: NDArray[np.bool_] = _free_batch(self._rows(configurations), *self.kernel_args)
        return result

    def clearance(self, configurations: ArrayLike) -> NDArray[np.float64]:
        """Distance from arm to discs for each of (N, d) rad, (N,) m; negative in collision."""
        result: NDArray[np.float64] = _clearance_batch(self._rows(configurations), *self.kernel_args[:3])
        return result

    def edge(self, start: ArrayLike, end: ArrayLike, resolution_rad: float) -> bool:
        """Whether the straight wrapped segment between two configurations (d,) is free."""
        start, end = (np.atleast_2d(np.asarray(q, dtype=np.float64)) for q in (start, end))
        return bool(self.edge_batch(start, end, resolution_rad)[0])

    def edge_batch(self, starts: ArrayLike, ends: ArrayLike, resolution_rad: float) -> NDArray[np.bool_]:
        """Which of the segments between (N, d) and (N, d) are free, (N,).

        Raises:
            ScenarioError: the shapes differ or the resolution is not positive.
        """
        first, second = self._rows(starts), self._rows(ends)
        if first.shape != second.shape or not resolution_rad > 0.0:
            raise ScenarioError(
                "the edges do not fit",
                expected="as many starts as ends and a positive resolution",
                got=f"{first.shape}, {second.shape}, {resolution_rad} rad",
            )
        result: NDArray[np.bool_] = _edge_batch(first, second, float(resolution_rad), *self.kernel_args)
        return result

    def _rows(self, configurations: ArrayLike) -> NDArray[np.float64]:
        rows = np.ascontiguousarray(configurations, dtype=np.float64)
        if rows.ndim != 2 or rows.shape[1] != self.scenario.robot.dim:
            raise ScenarioError(
                "the configurations do not fit the robot",
                expected=f"shape (N, {self.scenario.robot.dim})",
                got=str(rows.shape),
            )
        return rows
