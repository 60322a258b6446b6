"""What stands in a scene, and where in it a hand makes sense."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from cspace.errors import ScenarioError
from cspace.strict_json import read_object, settle, written
from cspace.worlds.spatial.obstacles.shapes import Box, Cylinder, Obstacles
from cspace.worlds.spatial.poses import Vector, pose_of


@dataclass(frozen=True, slots=True)
class GoalRegion:
    """Where goals of the hand are: places within a box, and the way in.

    Args:
        box: of the places, in the base frame; objects may stand in it.
        approach: unit vector in the base frame along which a hand comes in.

    Raises:
        ScenarioError: the approach has another length.
    """

    box: Box
    approach: Vector

    def __post_init__(self) -> None:
        settle(self)
        if not abs(np.linalg.norm(self.approach) - 1.0) < 1e-6:
            raise ScenarioError("an approach that is none", expected="a unit vector", got=str(self.approach))

    def draw(self, rng: np.random.Generator, count: int) -> NDArray[np.float64]:
        """Uniform places in the box, (count, 3) m in the base frame."""
        pose, half = np.array(self.box.pose), np.array(self.box.half_m)
        return np.asarray(rng.uniform(-half, half, (count, 3)) @ pose[:3, :3].T + pose[:3, 3])


@dataclass(frozen=True, slots=True)
class Layout:
    """A scene of a family.

    Args:
        family: its name.
        obstacles: in the base frame.
        regions: where goals make sense, at least one.
        focus: what cameras look at, m.
    """

    family: str
    obstacles: Obstacles
    regions: tuple[GoalRegion, ...]
    focus: Vector

    def __post_init__(self) -> None:
        settle(self)

    def to_dict(self) -> dict[str, Any]:
        """Plain values for JSON."""
        return written(self)


def read_layout(values: object) -> Layout:
    """The inverse of ``to_dict``.

    Raises:
        ScenarioError: a key or a value does not fit.
    """
    return read_object(Layout, values, "the scene", ScenarioError)


@dataclass(frozen=True, slots=True)
class Piece:
    """A piece of furniture with what stands on it, in any frame.

    Args:
        shapes: boxes and cylinders.
        regions: where goals make sense.
    """

    shapes: tuple[Box | Cylinder, ...]
    regions: tuple[GoalRegion, ...]

    def moved(self, pose: ArrayLike) -> "Piece":
        """The same in another frame, by the pose (4, 4) of this frame in that one."""
        by = np.asarray(pose, dtype=np.float64)
        regions = tuple(
            GoalRegion(_moved_box(one.box, by), _vector(by[:3, :3] @ one.approach)) for one in self.regions
        )
        return Piece(tuple(_moved(shape, by) for shape in self.shapes), regions)

    def __add__(self, other: "Piece") -> "Piece":
        return Piece(self.shapes + other.shapes, self.regions + other.regions)


def _moved(shape: Box | Cylinder, by: NDArray[np.float64]) -> Box | Cylinder:
    if isinstance(shape, Box):
        return _moved_box(shape, by)
    return Cylinder(pose_of(by @ np.array(shape.pose)), shape.radius_m, shape.half_length_m)


def _moved_box(box: Box, by: NDArray[np.float64]) -> Box:
    return Box(pose_of(by @ np.array(box.pose)), box.half_m)


def _vector(values: NDArray[np.float64]) -> Vector:
    return (float(values[0]), float(values[1]), float(values[2]))
