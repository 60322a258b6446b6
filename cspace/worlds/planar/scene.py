"""Scenarios: a robot among discs, seen by a camera, drawn from seeded families.

The splits never share a stream of random numbers, whatever the seeds: a scenario of the test split can not
appear in training.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import StrEnum
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cspace.errors import ScenarioError
from cspace.worlds.planar.arm import TWO_LINK, PlanarArm

DISC_COUNT = 3
DISC_RADIUS_M = 1.0
DISC_RANGE_M = 4.0
BASE_CLEARANCE_M = 1.3


class Split(StrEnum):
    """What a scenario may be used for."""

    TRAIN = "train"
    VALIDATION = "validation"
    TEST = "test"
    DEMO = "demo"


_SPLIT_KEYS = {Split.TRAIN: 1, Split.VALIDATION: 2, Split.TEST: 3, Split.DEMO: 4}


@dataclass(frozen=True, slots=True)
class Disc:
    """A round obstacle, in m."""

    x_m: float
    y_m: float
    radius_m: float = DISC_RADIUS_M


@dataclass(frozen=True, slots=True)
class Camera:
    """The part of the plane that the picture shows, y up, and its size in pixels (square)."""

    x_min_m: float = -5.0
    x_max_m: float = 5.0
    y_min_m: float = -5.0
    y_max_m: float = 5.0
    pixels: int = 48

    def to_dict(self) -> dict[str, Any]:
        """Plain values for JSON."""
        return {name: getattr(self, name) for name in ("x_min_m", "x_max_m", "y_min_m", "y_max_m", "pixels")}

    @classmethod
    def from_dict(cls, values: Mapping[str, Any]) -> "Camera":
        """The inverse of :meth:`to_dict`.

        Raises:
            ScenarioError: a key is missing, unknown or of the wrong type.
        """
        try:
            x_min_m, x_max_m, y_min_m, y_max_m = (
                float(values[key]) for key in ("x_min_m", "x_max_m", "y_min_m", "y_max_m")
            )
            return cls(x_min_m, x_max_m, y_min_m, y_max_m, int(values["pixels"]))
        except (KeyError, TypeError, ValueError) as error:
            raise ScenarioError(
                "the camera is unknown", expected="x and y ranges in m, pixels", got=repr(values)
            ) from error


@dataclass(frozen=True, slots=True)
class Scenario:
    """A robot among discs, seen by a camera."""

    robot: PlanarArm
    discs: tuple[Disc, ...]
    camera: Camera = field(default_factory=Camera)

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

    @classmethod
    def from_dict(cls, values: Mapping[str, Any]) -> "Scenario":
        """The inverse of :meth:`to_dict`."""
        return cls.from_array(
            PlanarArm.from_dict(values["robot"]),
            np.asarray(values["discs"], dtype=np.float64).reshape(-1, 3),
            Camera.from_dict(values["camera"]),
        )


def scenario_rng(split: Split, seed: int, index: int) -> np.random.Generator:
    """The random generator of one scenario; independent over splits, seeds and indices."""
    return np.random.default_rng(
        np.random.SeedSequence(entropy=seed, spawn_key=(_SPLIT_KEYS[Split(split)], index))
    )


def random_scenario(rng: np.random.Generator, robot: PlanarArm = TWO_LINK) -> Scenario:
    """Three discs of radius 1 m, centres uniform in [-4, 4]^2 m and at least 1.3 m from the base."""
    discs: list[Disc] = []
    while len(discs) < DISC_COUNT:
        x_m, y_m = rng.uniform(-DISC_RANGE_M, DISC_RANGE_M, size=2)
        if np.hypot(x_m, y_m) >= BASE_CLEARANCE_M:
            discs.append(Disc(float(x_m), float(y_m)))
    return Scenario(robot, tuple(discs))


def random_scenarios(split: Split, seed: int, count: int, robot: PlanarArm = TWO_LINK) -> list[Scenario]:
    """The first ``count`` scenarios of a split under a seed; a longer list starts with the shorter one."""
    return [random_scenario(scenario_rng(split, seed, index), robot) for index in range(count)]
