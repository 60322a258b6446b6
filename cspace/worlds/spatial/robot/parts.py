"""The pieces of a serial arm: its joints, and the rigid parts that spheres cover."""

from dataclasses import dataclass

import numpy as np

from cspace.errors import ScenarioError
from cspace.space import MAX_LIMIT_RAD
from cspace.strict_json import settle
from cspace.worlds.spatial.frames import MAX_OFFSET_M, SAME, Frame

# Of limits, for single precision to tell the angles between them apart.
MIN_RANGE_RAD = 1e-3
_UNIT = 1e-9
Sphere = tuple[float, float, float, float]


@dataclass(frozen=True, slots=True)
class Joint:
    """A revolute joint.

    Args:
        name: of the joint.
        origin: its frame, in that of the link before it, where its angle is zero.
        axis: what it turns about, a unit vector of its own frame.
        limits_rad: (low, high); None where it is a circle.

    Raises:
        ScenarioError: it has no name, the axis is no unit vector, or the limits are no range.
    """

    name: str
    origin: Frame = SAME
    axis: tuple[float, float, float] = (0.0, 0.0, 1.0)
    limits_rad: tuple[float, float] | None = None

    def __post_init__(self) -> None:
        settle(self)
        _check_name(self.name, "joint")
        length = float(np.linalg.norm(self.axis))
        if np.shape(self.axis) != (3,) or not abs(length - 1.0) <= _UNIT:
            raise ScenarioError(
                f"the axis of joint {self.name} does not fit",
                expected="x, y, z of a unit vector",
                got=str(self.axis),
            )
        limits = self.limits_rad
        if limits is None:
            return
        if np.shape(limits) != (2,) or not _is_range(*limits):
            raise ScenarioError(
                f"the limits of joint {self.name} do not fit",
                expected=f"None, or low < high by {MIN_RANGE_RAD} rad or more, within {MAX_LIMIT_RAD:.0f}",
                got=str(limits),
            )


@dataclass(frozen=True, slots=True)
class Part:
    """A rigid piece of the arm.

    Args:
        name: its own; that of the link of the description that it comes from.
        link: what it is fixed to: 0 for the base, k for what joint k moves.
        spheres_m: x, y, z in the link's frame and radius; together they cover the part.

    Raises:
        ScenarioError: it has no name or no spheres, or one of these is none.
    """

    name: str
    link: int
    spheres_m: tuple[Sphere, ...]

    def __post_init__(self) -> None:
        settle(self)
        _check_name(self.name, "part")
        try:
            numbers = np.asarray(self.spheres_m, dtype=np.float64)
        except ValueError:
            numbers = np.empty(0)
        if numbers.ndim != 2 or numbers.shape[1] != 4 or not np.isfinite(numbers).all():
            fits = False
        else:
            fits = bool(np.abs(numbers).max() <= MAX_OFFSET_M and numbers[:, 3].min() > 0.0)
        if not fits:
            raise ScenarioError(
                f"the spheres of part {self.name} do not fit",
                expected=f"one or more of x, y, z and a radius above 0, within {MAX_OFFSET_M:.0f} m",
                got=str(self.spheres_m)[:200],
            )


def _check_name(name: str, what: str) -> None:
    if not name:
        raise ScenarioError(f"a {what} has no name", expected="a text", got=repr(name)[:200])


def _is_range(low: float, high: float) -> bool:
    return -MAX_LIMIT_RAD <= low < high <= MAX_LIMIT_RAD and high - low >= MIN_RANGE_RAD
