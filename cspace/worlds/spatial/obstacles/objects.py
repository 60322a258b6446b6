"""Small things by chance: what stands on boards, what is anywhere; and boxes by their extents."""

from dataclasses import fields
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cspace.errors import ScenarioError
from cspace.worlds.spatial.obstacles.shapes import MAX_OBSTACLES, Box, Cylinder
from cspace.worlds.spatial.poses import make_pose, pose_of, turned

Range = tuple[float, float]
_THINNEST_M = 0.004
_LONGEST_M = 10.0
_HEIGHTS = ("lowest_m", "height_m", "high_m")


def block(*spans: Range, pose: NDArray[np.float64] | None = None) -> Box:
    """A box by its extents along x, y, z of a frame, m, at least 4 mm thick; ``pose``: of that frame."""
    ends = np.array(spans, dtype=np.float64)
    placed = make_pose(np.eye(3), ends.mean(axis=1))
    half = np.maximum((ends[:, 1] - ends[:, 0]) / 2, _THINNEST_M / 2)
    return Box(
        pose_of(placed if pose is None else pose @ placed), (float(half[0]), float(half[1]), float(half[2]))
    )


def within(span: Range, margin: float) -> Range:
    """An extent without a margin at either end; its middle where nothing would remain."""
    middle = (span[0] + span[1]) / 2
    return min(span[0] + margin, middle), max(span[1] - margin, middle)


def standing(
    rng: np.random.Generator, count: int, x: Range, y: Range, ground_m: float, tallest_m: float
) -> tuple[Box | Cylinder, ...]:
    """Upright boxes, plates and cylinders whose centres are within a rectangle, on its ground.

    Args:
        rng: draws them.
        count: how many.
        x: extent of the rectangle, m.
        y: extent of the rectangle, m.
        ground_m: height of what they stand on.
        tallest_m: above the ground; with less than 5 cm nothing stands there.
    """
    found: list[Box | Cylinder] = []
    for _ in range(count if tallest_m >= 0.05 else 0):
        high = rng.uniform(0.04, min(tallest_m, 0.45))
        place = make_pose(
            turned(rng.uniform(-np.pi, np.pi)), (rng.uniform(*x), rng.uniform(*y), ground_m + high / 2)
        )
        if rng.random() < 0.5:
            found.append(Cylinder(pose_of(place), float(rng.uniform(0.02, 0.08)), high / 2))
        else:
            thin = rng.random() < 0.3
            half = (
                float(rng.uniform(0.02, 0.13)),
                float(rng.uniform(0.005, 0.02 if thin else 0.13)),
                high / 2,
            )
            found.append(Box(pose_of(place), half))
    return tuple(found)


def floating(
    rng: np.random.Generator, count: int, reach_m: Range, bearing_rad: float
) -> tuple[Box | Cylinder, ...]:
    """Boxes and cylinders of any size and turn, anywhere to either side of the robot; some are long and thin.

    Args:
        rng: draws them.
        count: how many.
        reach_m: least and largest distance of their centres to the base's axis.
        bearing_rad: largest angle to the front.
    """
    found: list[Box | Cylinder] = []
    for _ in range(count):
        bearing, away = rng.uniform(-bearing_rad, bearing_rad), rng.uniform(*reach_m)
        turn = turned(
            *rng.uniform(-np.pi, np.pi, 3) * ((1.0, 0.5, 0.5) if rng.random() < 0.5 else (1.0, 0.0, 0.0))
        )
        place = (away * np.cos(bearing), away * np.sin(bearing), rng.uniform(-0.3, 1.1))
        pose = pose_of(make_pose(turn, place))
        half = np.exp(rng.uniform(np.log(0.015), np.log(0.2), 3))
        if rng.random() < 0.2:
            half[2] = rng.uniform(0.3, 0.8)
            half[:2] = np.minimum(half[:2], 0.05)
        if rng.random() < 0.4:
            found.append(Cylinder(pose, float(half[0]), float(half[2])))
        else:
            found.append(Box(pose, (float(half[0]), float(half[1]), float(half[2]))))
    return tuple(found)


def check_ranges(settings: Any) -> None:
    """Refuse settings of furniture that cannot be.

    Pairs of numbers are ranges: of counts, of heights, which may be below the base, and of sizes above 0.
    Other numbers are shares.

    Raises:
        ScenarioError: a range is not in order or out of bounds, or a share is none.
    """
    for item in fields(settings):
        value = getattr(settings, item.name)
        if not (_is_range(item.name, *value) if isinstance(value, tuple) else 0.0 <= value <= 1.0):
            raise ScenarioError(
                f"the setting {item.name} of {type(settings).__name__.lower()} does not fit",
                expected="a range from low to high, or a share",
                got=repr(value)[:200],
            )


def _is_range(name: str, low: float, high: float) -> bool:
    if isinstance(low, int):
        return 0 <= low <= high <= MAX_OBSTACLES
    least = -_LONGEST_M if name in _HEIGHTS else _THINNEST_M
    return least <= low <= high <= _LONGEST_M
