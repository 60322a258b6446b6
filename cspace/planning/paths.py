"""Paths: length, even spacing, shortcuts, and configurations along them."""

from collections.abc import Sequence
from itertools import pairwise

import numpy as np
from numpy.typing import ArrayLike, NDArray

from cspace.simulator import SHORTEST_SPAN, Checker
from cspace.space import JointSpace

# Shortcuts that are looked at together: one call of compiled code for all of them.
_TOGETHER = 16


def spaced(path: ArrayLike, space: JointSpace, step_rad: float) -> NDArray[np.float64]:
    """The same path in steps of at most ``step_rad``, equal within each of its pieces; corners are kept."""
    rows = np.asarray(path, dtype=np.float64)
    pieces = [rows[:1]]
    for begin, end in pairwise(rows):
        step = space.difference(begin, end)
        count = max(1, int(np.ceil(np.linalg.norm(step) / step_rad)))
        shares = np.arange(1, count)[:, None] / count
        pieces += [space.wrap(begin + shares * step), end[None]]
    return np.concatenate(pieces)


def length_rad(path: ArrayLike, space: JointSpace) -> float:
    """Euclidean length of a path (k, d) rad."""
    rows = np.asarray(path, dtype=np.float64)
    return float(space.distance(rows[:-1], rows[1:]).sum())


def spread_points(path: NDArray[np.float64], count: int, space: JointSpace) -> NDArray[np.float64]:
    """``count`` points at equal distances along a path (k, d) rad, its ends included, (count, d) rad."""
    steps = space.difference(path[:-1], path[1:])
    lengths = np.linalg.norm(steps, axis=1)
    reached = np.concatenate([[0.0], np.cumsum(lengths)])
    wanted = np.linspace(0.0, 1.0, count) * reached[-1]
    edge = np.clip(np.searchsorted(reached, wanted, side="right") - 1, 0, len(steps) - 1)
    along = (wanted - reached[edge]) / np.maximum(lengths[edge], np.finfo(np.float64).tiny)
    return space.wrap(path[edge] + np.clip(along, 0.0, 1.0)[:, None] * steps[edge])


def shortcut(
    checker: Checker,
    path: NDArray[np.float64],
    rng: np.random.Generator,
    shortcuts: int,
    resolution_rad: float,
) -> NDArray[np.float64]:
    """The path with straight pieces between random points of it wherever these are free and shorter.

    Source: Geraerts and Overmars, Creating High-Quality Paths for Motion Planning, IJRR 26 (2007). Proposals
    are looked at some at a time, and of those that are free the one that gains most is taken.
    """
    space = checker.space
    for _ in range(0, shortcuts, _TOGETHER):
        # Pieces of no length are no pieces.
        steps = space.difference(path[:-1], path[1:])
        sizes = np.linalg.norm(steps, axis=1)
        if len(path) < 3 or not sizes.sum() > 0.0:
            return path
        gone = np.concatenate([[0.0], np.cumsum(sizes)])
        span = SHORTEST_SPAN ** rng.random(_TOGETHER)
        first = rng.random(_TOGETHER) * (1.0 - span)
        cuts = np.stack([first, first + span]) * gone[-1]
        at = np.clip(np.searchsorted(gone, cuts, side="right") - 1, 0, len(sizes) - 1)
        shares = (cuts - gone[at]) / np.maximum(sizes[at], 1e-12)
        points = space.wrap(path[at] + np.minimum(shares, 1.0)[..., None] * steps[at])
        gains = cuts[1] - cuts[0] - space.distance(points[0], points[1])
        free = checker.edge_batch(points[0], points[1], resolution_rad)
        best = int(np.argmax(np.where(free, gains, 0.0)))
        if free[best] and gains[best] > 1e-4:
            i, j = at[0, best], at[1, best]
            path = np.concatenate([path[: i + 1], points[:, best], path[j + 1 :]])
    return path


# Standard deviations of the noise, each joint, from turn to turn; and how far apart draws are along a path.
NOISE_RAD = (0.0, 0.05, 0.1, 0.2)
STEP_RAD = 0.3


class AlongPaths:
    """A stream of configurations about paths.

    A turn goes along one path after the other, each from its start to its goal; each next turn adds more
    noise, and all that follow the last of :data:`NOISE_RAD` as much as it does. No configuration leaves
    ``space``.
    """

    def __init__(
        self, paths: Sequence[NDArray[np.float64]], space: JointSpace, rng: np.random.Generator
    ) -> None:
        lines = [spaced(path, space, STEP_RAD) for path in paths]
        self._line, self._space, self._rng = np.concatenate(lines), space, rng
        self._number = np.repeat(np.arange(len(lines)), [len(line) for line in lines])
        self._turn, self._at = 0, 0
        self._rows = self._line

    def take(self, count: int) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
        """The next configurations (count, d) rad, and the number of each one's path (count,)."""
        rows, numbers = [self._rows[:0]], [self._number[:0]]
        while count > 0:
            part = slice(self._at, min(self._at + count, len(self._line)))
            rows.append(self._rows[part])
            numbers.append(self._number[part])
            count, self._at = count - (part.stop - part.start), part.stop
            if self._at == len(self._line):
                self._next_turn()
        return np.concatenate(rows), np.concatenate(numbers)

    @property
    def turn_rows(self) -> int:
        """Configurations of one turn."""
        return len(self._line)

    def _next_turn(self) -> None:
        self._turn, self._at = self._turn + 1, 0
        sigma = NOISE_RAD[min(self._turn, len(NOISE_RAD) - 1)]
        self._rows = self._space.bound(self._line + sigma * self._rng.normal(size=self._line.shape))
