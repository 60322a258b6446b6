"""Geometry of the joint space: circles and limited joints, wrapping, distances, embedding, standardisation.

Angles are in rad; arrays hold configurations in their last axis, one entry per joint. The plain functions are
those of the torus; :class:`JointSpace` alone knows which joint is a circle and which has limits.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from cspace.errors import InputError

Floats = NDArray[np.floating[Any]]
_TURN = 2.0 * np.pi
# A value that lies this little beyond a limit is there by rounding, and is taken as that limit.
LIMIT_TOLERANCE_RAD = 1e-4
# How far beyond a limit an encoder, a hand-guided or a sagging arm may read.
NEAR_LIMIT_RAD = 0.1
# Farther from 0 than three turns an angle of a circle is more likely in degrees than unwrapped.
MAX_CIRCLE_RAD = 3.0 * _TURN

# float32(pi) lies above pi; this is the largest float32 below it, so that [-pi, pi) survives the cast.
FLOAT32_PI_BELOW = np.nextafter(np.float32(np.pi), np.float32(0.0))
# Of a joint, either way: further out single precision could not tell neighbouring configurations apart.
MAX_LIMIT_RAD = 1000.0
# Of limits, for single precision to tell the angles between them apart.
MIN_RANGE_RAD = 1e-3


def wrap(angles: ArrayLike) -> NDArray[np.float64]:
    """Angles brought into [-pi, pi). ``angles``: any shape, rad."""
    wrapped = np.mod(np.asarray(angles, dtype=np.float64) + np.pi, 2.0 * np.pi) - np.pi
    # The modulo of a tiny negative number rounds up to the full period.
    return np.where(wrapped >= np.pi, -np.pi, wrapped)


def difference(start: ArrayLike, end: ArrayLike) -> NDArray[np.float64]:
    """The shortest way round from ``start`` to ``end`` for every joint, in [-pi, pi) rad."""
    return wrap(np.asarray(end, dtype=np.float64) - np.asarray(start, dtype=np.float64))


@dataclass(frozen=True, slots=True)
class JointSpace:
    """A robot's joint space: circles for periodic joints, intervals for the others."""

    lower: tuple[float, ...]  # lower end of each joint, rad; -pi where periodic
    upper: tuple[float, ...]  # upper end of each joint, rad; pi where periodic
    periodic: tuple[bool, ...]  # whether the joint is a circle
    names: tuple[str, ...] = field(default=(), compare=False)  # for messages; else numbered from 1

    @property
    def dim(self) -> int:
        return len(self.lower)

    def sample_uniform(self, rng: np.random.Generator, count: int) -> NDArray[np.float64]:
        """``count`` uniform configurations, (count, d) rad."""
        return rng.uniform(self.lower, self.upper, size=(count, self.dim))

    @property
    def is_torus(self) -> bool:
        return all(self.periodic)

    @property
    def volume(self) -> float:
        """Product of the joints' ranges, rad to the power of d."""
        limited = [
            high - low
            for low, high, wraps in zip(self.lower, self.upper, self.periodic, strict=True)
            if not wraps
        ]
        return float(_TURN ** (self.dim - len(limited)) * np.prod(limited))

    def wrap(self, configurations: ArrayLike) -> NDArray[np.float64]:
        """Periodic joints wrapped, the others as they are; (..., d) rad."""
        configurations = np.asarray(configurations, dtype=np.float64)
        return np.where(self.periodic, wrap(configurations), configurations)

    def bound(self, configurations: ArrayLike) -> NDArray[np.float64]:
        """Circles wrapped, limited joints turned into their limits or set to the nearer one; (..., d) rad."""
        wrapped = wrap(configurations)
        if self.is_torus:
            return wrapped
        values, low, high = (
            np.asarray(part, np.float64) for part in (configurations, self.lower, self.upper)
        )
        beyond = np.maximum(low - values, values - high)
        first, last = low + np.mod(values - low, _TURN), high - np.mod(high - values, _TURN)
        turned = np.where(values < low, first, last)
        nearer = np.where(first - high <= low + _TURN - first, high, low)
        moved = np.where(first <= high, turned, nearer)
        inside = np.clip(np.where(beyond <= LIMIT_TOLERANCE_RAD, values, moved), low, high)
        return np.where(self.periodic, wrapped, inside)

    def to_float32(self, configurations: ArrayLike) -> NDArray[np.float32]:
        """As :meth:`bound` in float32 that still lies inside as real numbers (clipped after the cast)."""
        low, high = _float32_limits(self)
        return np.clip(self.bound(configurations).astype(np.float32), low, high)

    def embed(self, configurations: ArrayLike) -> NDArray[np.float64]:
        """(..., d) to cosines of all circles, then their sines, then the other joints as they are in rad."""
        configurations = np.asarray(configurations, dtype=np.float64)
        circles = np.asarray(self.periodic)
        angles, others = configurations[..., circles], configurations[..., ~circles]
        return np.concatenate([np.cos(angles), np.sin(angles), others], axis=-1)

    def difference(self, start: ArrayLike, end: ArrayLike) -> NDArray[np.float64]:
        """The straight way from ``start`` to ``end``, round the shorter side of each circle; (..., d) rad."""
        plain = np.asarray(end, dtype=np.float64) - np.asarray(start, dtype=np.float64)
        if not any(self.periodic):
            return plain
        return np.where(self.periodic, wrap(plain), plain)

    def distance(self, start: ArrayLike, end: ArrayLike) -> NDArray[np.float64]:
        return np.asarray(np.linalg.norm(self.difference(start, end), axis=-1))

    def contains(self, configurations: ArrayLike) -> NDArray[np.bool_]:
        """Whether each of (..., d) lies within the limits of the joints that have some."""
        configurations = np.asarray(configurations, dtype=np.float64)
        inside = (configurations >= self.lower) & (configurations <= self.upper)
        return np.asarray(np.all(inside | np.asarray(self.periodic), axis=-1))

    def keeps_pose(self, configurations: ArrayLike) -> NDArray[np.bool_]:
        """Whether :meth:`bound` leaves each of (..., d) in its pose but for rounding, (...,)."""
        values = np.asarray(configurations, dtype=np.float64)
        if self.is_torus:
            return np.ones(values.shape[:-1], dtype=np.bool_)
        moved = np.abs(difference(values, self.bound(values))) > LIMIT_TOLERANCE_RAD
        return np.asarray(~np.any(moved & ~np.asarray(self.periodic), axis=-1))

    def admitted(
        self,
        configurations: ArrayLike,
        what: str,
        error: type[InputError] = InputError,
        beyond_rad: float = LIMIT_TOLERANCE_RAD,
    ) -> NDArray[np.float64]:
        """Configurations (d,) or (n, d) rad of files and requests, checked and clamped to the limits.

        ``beyond_rad``: how far beyond a limit a value is still clamped. Circles stay as they are, within
        ``MAX_CIRCLE_RAD`` of 0. ``what``: the clause of the error's message.
        """
        values = np.asarray(configurations, dtype=np.float64)
        low = np.where(self.periodic, -MAX_CIRCLE_RAD, self.lower)
        high = np.where(self.periodic, MAX_CIRCLE_RAD, self.upper)
        fits = (values >= low - beyond_rad) & (values <= high + beyond_rad)
        if fits.all():
            return np.clip(values, low, high)
        *row, joint = np.argwhere(~fits)[0]
        name = self.names[joint] if self.names else f"joint {joint + 1}"
        wrong = np.count_nonzero(~fits.all(axis=-1))
        raise error(
            what,
            expected=f"{name} from {low[joint]:.8g} to {high[joint]:.8g} rad"
            + (", three turns of a circle either way" if self.periodic[joint] else ""),
            got=(f"{wrong} of {len(fits)} rows outside, the first is row {row[0]}: " if row else "")
            + f"{name} at {values[(*row, joint)]:.8g} rad",
            remedy="send angles in rad, not in degrees, as the joints stand"
            if np.abs(values).max() > _TURN
            else f"send {name} within its limits",
        )

    def narrowed(self, limits: Sequence[Sequence[float] | None]) -> "JointSpace":
        """The space whose joints keep to (low, high) rad each, at any turn, or as they are where None."""
        if len(limits) != self.dim:
            expected = f"{self.dim} entries, each [low, high] in rad, or null for the joint's own"
            raise InputError("limits do not fit the robot", expected=expected, got=f"{len(limits)} entries")
        ends = [list(self.lower), list(self.upper)]
        for joint, given in enumerate(limits):
            if given is None:
                continue
            circle = self.periodic[joint]
            least, most = (-MAX_CIRCLE_RAD, MAX_CIRCLE_RAD) if circle else (ends[0][joint], ends[1][joint])
            low, high = given
            inside = least - LIMIT_TOLERANCE_RAD <= low and high <= most + LIMIT_TOLERANCE_RAD
            if not inside or not high - low >= MIN_RANGE_RAD:
                name = self.names[joint] if self.names else f"joint {joint + 1}"
                raise InputError(
                    f"limits do not fit {name}",
                    expected=f"low < high by {MIN_RANGE_RAD:g} rad or more, "
                    f"within {least:.8g} to {most:.8g} rad",
                    got=f"[{low:.8g}, {high:.8g}]",
                    remedy="narrow the robot's own limits; null leaves a joint as it is",
                )
            ends[0][joint], ends[1][joint] = max(low, least), min(high, most)
        periodic = tuple(wraps and given is None for wraps, given in zip(self.periodic, limits, strict=True))
        return JointSpace(tuple(ends[0]), tuple(ends[1]), periodic, self.names)

    def unwrap(self, path: ArrayLike, start: ArrayLike) -> NDArray[np.float64]:
        """A path (k, d) rad whose circles go on beyond [-pi, pi) from a start (d,) instead of jumping."""
        rows = np.asarray(path, dtype=np.float64)
        going_on = np.unwrap(np.concatenate([np.asarray(start, dtype=np.float64)[None], rows]), axis=0)[1:]
        return np.where(self.periodic, going_on, rows)

    def to_dict(self) -> dict[str, Any]:
        """As bundles and answers write it: a ``torus`` of circles, a ``box`` without, else ``mixed``."""
        kind = "torus" if self.is_torus else "mixed" if any(self.periodic) else "box"
        values: dict[str, Any] = {"kind": kind, "dim": self.dim, "unit": "rad"}
        if not self.is_torus:
            values |= {name: list(getattr(self, name)) for name in ("lower", "upper", "periodic")}
        return values


def is_range(low: float, high: float) -> bool:
    """Whether single precision tells the angles of a limited joint apart, rad."""
    return -MAX_LIMIT_RAD <= low < high <= MAX_LIMIT_RAD and high - low >= MIN_RANGE_RAD


def circles(dim: int) -> JointSpace:
    """The torus: ``dim`` joints without limits."""
    return JointSpace((-np.pi,) * dim, (np.pi,) * dim, (True,) * dim)


@lru_cache(maxsize=64)
def _float32_limits(space: JointSpace) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """The float32 limits nearest to a space's that do not lie beyond them as real numbers, (d,) rad each."""
    low, high = (
        np.where(space.periodic, side, _towards(ends, towards))
        for side, ends, towards in (
            (-FLOAT32_PI_BELOW, space.lower, space.upper),
            (FLOAT32_PI_BELOW, space.upper, space.lower),
        )
    )
    return low, high


def _towards(ends: Sequence[float], inside: Sequence[float]) -> NDArray[np.float32]:
    """The float32 nearest to each end that is not beyond it as a real number."""
    cast, goal = np.asarray(ends, dtype=np.float32), np.asarray(inside, dtype=np.float32)
    # By their signs: the product of two small numbers may be none.
    beyond = np.sign(np.subtract(cast, ends, dtype=np.float64)) * np.sign(np.subtract(inside, ends)) < 0.0
    return np.where(beyond, np.nextafter(cast, goal), cast)
