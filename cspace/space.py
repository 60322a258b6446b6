"""Geometry of the joint space: wrapping, torus distance, the (cos, sin) embedding, standardisation.

Angles are in rad; arrays hold configurations in their last axis, one entry per joint.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from cspace.errors import ScenarioError

Floats = NDArray[np.floating[Any]]

# float32(pi) lies above pi; this is the largest float32 below it, so that [-pi, pi) survives the cast.
FLOAT32_PI_BELOW = np.nextafter(np.float32(np.pi), np.float32(0.0))


def wrap(angles: ArrayLike) -> NDArray[np.float64]:
    """Angles brought into [-pi, pi).

    Args:
        angles: any shape, rad.
    """
    wrapped = np.mod(np.asarray(angles, dtype=np.float64) + np.pi, 2.0 * np.pi) - np.pi
    # The modulo of a tiny negative number rounds up to the full period.
    return np.where(wrapped >= np.pi, -np.pi, wrapped)


def difference(start: ArrayLike, end: ArrayLike) -> NDArray[np.float64]:
    """The shortest way round from ``start`` to ``end`` for every joint, in [-pi, pi) rad."""
    return wrap(np.asarray(end, dtype=np.float64) - np.asarray(start, dtype=np.float64))


def torus_distance(start: ArrayLike, end: ArrayLike) -> NDArray[np.float64]:
    """Euclidean length of the shortest way round on the torus, (...,) rad for inputs (..., d)."""
    return np.asarray(np.linalg.norm(difference(start, end), axis=-1))


def embed(angles: ArrayLike) -> NDArray[np.float64]:
    """(..., d) angles to (..., 2 d): the cosines of all joints, then their sines."""
    angles = np.asarray(angles, dtype=np.float64)
    return np.concatenate([np.cos(angles), np.sin(angles)], axis=-1)


def unembed(embedded: ArrayLike) -> NDArray[np.float64]:
    """(..., 2 d) cosines and sines back to (..., d) angles in [-pi, pi); lengths do not matter."""
    cosines, sines = np.split(np.asarray(embedded, dtype=np.float64), 2, axis=-1)
    return wrap(np.arctan2(sines, cosines))


def to_float32(angles: ArrayLike) -> NDArray[np.float32]:
    """Wrapped angles as float32 that still lie in [-pi, pi) as real numbers (clipped after the cast)."""
    return np.clip(wrap(angles).astype(np.float32), -FLOAT32_PI_BELOW, FLOAT32_PI_BELOW)


@dataclass(frozen=True, slots=True)
class JointSpace:
    """A robot's joint space: circles for periodic joints, intervals for the others.

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
        """Periodic joints wrapped, the others as they are; (..., d) rad."""
        configurations = np.asarray(configurations, dtype=np.float64)
        return np.where(self.periodic, wrap(configurations), configurations)

    def difference(self, start: ArrayLike, end: ArrayLike) -> NDArray[np.float64]:
        """The straight way from ``start`` to ``end``, round the shorter side of each circle; (..., d) rad."""
        plain = np.asarray(end, dtype=np.float64) - np.asarray(start, dtype=np.float64)
        return np.where(self.periodic, wrap(plain), plain)

    def distance(self, start: ArrayLike, end: ArrayLike) -> NDArray[np.float64]:
        """Euclidean length of :meth:`difference`, (...,) rad."""
        return np.asarray(np.linalg.norm(self.difference(start, end), axis=-1))

    def contains(self, configurations: ArrayLike) -> NDArray[np.bool_]:
        """Whether each of (..., d) lies within the limits of the joints that have some."""
        configurations = np.asarray(configurations, dtype=np.float64)
        inside = (configurations >= self.lower) & (configurations <= self.upper)
        return np.asarray(np.all(inside | np.asarray(self.periodic), axis=-1))


@dataclass(frozen=True, slots=True)
class Standardisation:
    """An affine map to zero mean and unit variance, per joint.

    Args:
        mean: (d,) rad.
        std: (d,) rad, positive.

    Raises:
        ScenarioError: a standard deviation is not positive.
    """

    mean: tuple[float, ...]
    std: tuple[float, ...]

    def __post_init__(self) -> None:
        if len(self.mean) != len(self.std) or any(not value > 0.0 for value in self.std):
            raise ScenarioError(
                "the standardisation does not fit",
                expected="one mean and one positive deviation a joint",
                got=f"mean {self.mean}, std {self.std}",
            )

    @classmethod
    def fit(cls, configurations: ArrayLike) -> "Standardisation":
        """Mean and standard deviation of (n, d) configurations."""
        configurations = np.asarray(configurations, dtype=np.float64)
        return cls(
            tuple(float(v) for v in configurations.mean(axis=0)),
            tuple(float(v) for v in configurations.std(axis=0)),
        )

    def standardise(self, configurations: ArrayLike) -> NDArray[np.float64]:
        """(..., d) rad to (..., d) without unit."""
        return np.asarray((np.asarray(configurations, dtype=np.float64) - self.mean) / self.std)

    def restore(self, standardised: ArrayLike) -> NDArray[np.float64]:
        """The inverse of :meth:`standardise`."""
        return np.asarray(np.asarray(standardised, dtype=np.float64) * self.std + self.mean)
