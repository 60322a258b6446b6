"""Scenarios: a robot among discs, seen by a camera."""

from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cspace.splits import Split, scenario_rng
from cspace.strict_json import settle
from cspace.worlds.planar.arm import TWO_LINK, PlanarArm
from cspace.worlds.planar.scenes import DiscScenes, Scenes
from cspace.worlds.planar.seeing.camera import Camera
from cspace.worlds.planar.world import PlanarWorld

DISC_RADIUS_M = 1.0


@dataclass(frozen=True, slots=True)
class Disc:
    """A round obstacle, in m."""

    x_m: float
    y_m: float
    radius_m: float = DISC_RADIUS_M

    def __post_init__(self) -> None:
        settle(self)


@dataclass(frozen=True, slots=True)
class Scenario:
    """A robot among discs, seen by a camera."""

    robot: PlanarArm
    discs: tuple[Disc, ...]
    camera: Camera = field(default_factory=Camera)

    @property
    def world(self) -> PlanarWorld:
        """Arm and camera."""
        return PlanarWorld(self.robot, self.camera)

    @property
    def disc_array(self) -> NDArray[np.float64]:
        """(D, 3): x, y, radius in m."""
        return np.array([(d.x_m, d.y_m, d.radius_m) for d in self.discs], dtype=np.float64).reshape(-1, 3)

    @classmethod
    def from_array(cls, robot: PlanarArm, discs: NDArray[Any], camera: Camera | None = None) -> "Scenario":
        """A scenario from (D, 3) discs: x, y, radius in m."""
        return cls(robot, tuple(Disc(float(x), float(y), float(r)) for x, y, r in discs), camera or Camera())

    def to_dict(self) -> dict[str, Any]:
        """Plain values for JSON."""
        return {
            "robot": self.robot.to_dict(),
            "discs": self.disc_array.tolist(),
            "camera": self.camera.to_dict(),
        }


def random_scenario(
    rng: np.random.Generator,
    robot: PlanarArm = TWO_LINK,
    scenes: Scenes = DiscScenes(),  # noqa: B008 - a frozen value
    split: Split = Split.TRAIN,
    index: int | None = None,
) -> Scenario:
    """A scenario of a family, or a given one; see :mod:`cspace.worlds.planar.scenes`."""
    return Scenario.from_array(robot, scenes.draw(rng, split, index))


def random_scenarios(
    split: Split,
    seed: int,
    count: int,
    robot: PlanarArm = TWO_LINK,
    scenes: Scenes = DiscScenes(),  # noqa: B008 - a frozen value
) -> list[Scenario]:
    """The first ``count`` scenarios of a split under a seed; a longer list starts with the shorter one."""
    return [
        random_scenario(scenario_rng(split, seed, index), robot, scenes, split, index)
        for index in range(count)
    ]
