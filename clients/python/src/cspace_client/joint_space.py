"""The joint space that an answer tells: which joints are circles, and the others' limits."""

from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray

MAX_LIMIT_RAD = 1000.0
"""Of a joint, either way; further out single precision tells neighbours no longer apart."""

LIMIT_TOLERANCE_RAD = 1e-4
"""A value that lies this little beyond a limit is there by rounding, and is taken as that limit."""

_TURN = 2.0 * np.pi
MAX_CIRCLE_RAD = 3.0 * _TURN
"""Farther from 0 an angle of a circle is more likely in degrees than unwrapped."""


class Joints(Protocol):
    """What a planner's draws need of a joint space, whoever made it."""

    @property
    def dim(self) -> int:
        """d, number of joints."""

    @property
    def lower(self) -> tuple[float, ...]:
        """Lower end of each joint, rad."""

    @property
    def upper(self) -> tuple[float, ...]:
        """Upper end of each joint, rad."""

    @property
    def periodic(self) -> tuple[bool, ...]:
        """Whether each joint is a circle."""

    def wrap(self, configurations: ArrayLike) -> NDArray[np.float64]:
        """Periodic joints brought into [-pi, pi), the others as they are; (..., d) rad."""

    def sample_uniform(self, rng: np.random.Generator, count: int) -> NDArray[np.float64]:
        """``count`` uniform configurations, (count, d) rad."""


@dataclass(frozen=True, slots=True)
class JointSpace:
    """Circles for periodic joints, intervals for the others.

    Args:
        lower: lower end of each joint, rad; -pi where periodic.
        upper: upper end of each joint, rad; pi where periodic.
        periodic: whether the joint is a circle.
    """

    lower: tuple[float, ...]
    upper: tuple[float, ...]
    periodic: tuple[bool, ...]

    @property
    def dim(self) -> int:
        """Number of joints."""
        return len(self.lower)

    def sample_uniform(self, rng: np.random.Generator, count: int) -> NDArray[np.float64]:
        """``count`` uniform configurations, (count, d) rad."""
        return rng.uniform(self.lower, self.upper, size=(count, self.dim))

    def wrap(self, configurations: ArrayLike) -> NDArray[np.float64]:
        """Periodic joints brought into [-pi, pi), the others as they are; (..., d) rad."""
        values = np.asarray(configurations, dtype=np.float64)
        wrapped = np.mod(values + np.pi, _TURN) - np.pi
        # The modulo of a tiny negative number rounds up to the full period.
        return np.where(self.periodic, np.where(wrapped >= np.pi, -np.pi, wrapped), values)

    def distance(self, start: ArrayLike, end: ArrayLike) -> NDArray[np.float64]:
        """Euclidean length of the straight way, round the shorter side of each circle; (...,) rad."""
        apart = np.asarray(end, dtype=np.float64) - np.asarray(start, dtype=np.float64)
        return np.asarray(np.linalg.norm(self.wrap(apart), axis=-1))

    def clamp(self, configurations: ArrayLike) -> NDArray[np.float64]:
        """Joints that lie up to ``LIMIT_TOLERANCE_RAD`` beyond a limit brought to it; (..., d) rad."""
        values = np.asarray(configurations, dtype=np.float64)
        inside = np.clip(values, self.lower, self.upper)
        near = ~np.asarray(self.periodic) & (np.abs(values - inside) <= LIMIT_TOLERANCE_RAD)
        return np.where(near, inside, values)

    def contains(self, configurations: ArrayLike) -> NDArray[np.bool_]:
        """Whether each of (..., d) lies within the limits of the joints that have some."""
        values = np.asarray(configurations, dtype=np.float64)
        inside = (values >= self.lower) & (values <= self.upper)
        return np.asarray(np.all(inside | np.asarray(self.periodic), axis=-1))

    def admits(self, configurations: ArrayLike) -> NDArray[np.bool_]:
        """As :meth:`contains`, and all circles within ``MAX_CIRCLE_RAD`` of 0."""
        turns = np.abs(np.asarray(configurations, dtype=np.float64)) <= MAX_CIRCLE_RAD
        near = np.all(turns | ~np.asarray(self.periodic), axis=-1)
        return np.asarray(self.contains(configurations) & near)

    def holds(self, configurations: NDArray[np.floating[Any]]) -> NDArray[np.bool_]:
        """Which values of (..., d) lie in their joint's range, circles in [-pi, pi).

        Limits are compared in the precision of the values, for they may have been rounded to it.
        """
        low, high = (np.asarray(ends, dtype=configurations.dtype) for ends in (self.lower, self.upper))
        limited = (configurations >= low) & (configurations <= high)
        exact = configurations.astype(np.float64)
        return np.where(self.periodic, (exact >= -np.pi) & (exact < np.pi), limited)


def circles(dim: int) -> JointSpace:
    """``dim`` joints without limits."""
    return JointSpace((-np.pi,) * dim, (np.pi,) * dim, (True,) * dim)
