"""The spatial world as a value: a serial arm, depth cameras about it, and the families of its scenes."""

import json
from collections.abc import Mapping
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from typing import Any, ClassVar, cast

import numpy as np
from numpy.typing import ArrayLike, NDArray

from cspace.errors import ConfigError, DatasetError, ImageError, InputError, ScenarioError
from cspace.files import read_bounded, read_json, read_object, validated
from cspace.view_file import View
from cspace.world import (
    Arrays,
    CheckCancelled,
    Contact,
    Diagnosis,
    Examined,
    Finding,
    GridArm,
    Known,
    World,
)
from cspace.worlds.spatial.arm import SerialArm, grouped, touching_sets
from cspace.worlds.spatial.diagnosis import (
    diagnose,
    least_novelty,
    picture_findings,
    pose_findings,
    state_findings,
    view_findings,
)
from cspace.worlds.spatial.furniture import SpatialScenes
from cspace.worlds.spatial.obstacles import BOX_VALUES, CYLINDER_VALUES
from cspace.worlds.spatial.planning_scene import PlanningScene
from cspace.worlds.spatial.sensor import (
    DISTANCE_STEP_M,
    NETWORK_MULTIPLE,
    NO_READING,
    DepthSensor,
    grid_of,
)
from cspace.worlds.spatial.view import DepthView, read_view
from cspace.worlds.spatial.visibility import fused, observe

_ROBOTS = Path(__file__).with_name("robots")


@dataclass(frozen=True, slots=True)
class SpatialWorld(World):
    """A serial arm that depth cameras see; ``boxes`` (S, any, 15), ``cylinders`` (S, any, 14), NaN behind."""

    kind: ClassVar[str] = "spatial"
    scene_files: ClassVar[tuple[str, ...]] = ("boxes", "cylinders")

    body: SerialArm
    sensor: DepthSensor
    scenes: SpatialScenes | None

    @property
    def motion_limits(self) -> tuple[tuple[float, ...] | None, tuple[float, ...] | None]:
        """See :meth:`cspace.world.World.motion_limits`."""
        return self.body.max_velocity_rad_s, self.body.max_acceleration_rad_s2

    def view(self, data: bytes | View) -> DepthView:
        return read_view(data, self.body)

    def examine_picture(self, data: bytes | View, check_cancelled: CheckCancelled = lambda: None) -> Examined:
        return self.examined(read_view(data, self.body, check_cancelled), check_cancelled)

    def least_novelty(self, image: NDArray[np.uint8]) -> float:
        return least_novelty(self.body, self.sensor.grid, image)

    def state_findings(
        self,
        *,
        image: NDArray[np.uint8] | None = None,
        start: ArrayLike | None = None,
        colliding: float = 0.0,
    ) -> tuple[Finding, ...]:
        return tuple(state_findings(self.body, self.sensor.grid, image, start, colliding))

    def observed(self, view: DepthView) -> NDArray[np.uint8]:
        """What a view says of the space about the arm, (X, Y, Z, 2)."""
        return fused(self._each(view, lambda: None))

    def examined(self, view: DepthView, check_cancelled: CheckCancelled = lambda: None) -> Examined:
        """:meth:`observed`, (1, X, Y, Z, 2), with what is to be said of the view."""
        known = None if view.known is None else self.scene_checker(view.known)
        posed = pose_findings(self.body if known is None else known.arm, view)
        single = self._each(view, check_cancelled, known)
        image = fused(single)
        if known is not None:
            known.complete(image, self.sensor.grid, check_cancelled)
        findings = (*picture_findings(self.body, self.sensor, view, single, image, posed), *posed)
        return Examined(image[None], findings, None in view.states, known, len(view.pictures))

    def scene_checker(self, known: PlanningScene) -> Any:
        """What is known, for this arm, as a :class:`cspace.worlds.spatial.scene_checker.SceneChecker`."""
        try:
            return import_module("cspace.worlds.spatial.scene_checker").SceneChecker(self.body, known)
        except ImportError as error:
            raise InputError(
                "known bodies cannot be checked here",
                expected="the extra plan",
                got=f"no {error.name}",
                remedy="pip install -c constraints.txt '.[plan]'",
            ) from error

    def contact(
        self, configuration: NDArray[np.floating], image: NDArray[np.uint8], known: Known | None
    ) -> Contact | None:
        found: Any = self.scene_checker(PlanningScene()) if known is None else known
        return cast("Contact | None", found.contact(configuration, image, self.sensor.grid))

    def diagnosis(self, data: bytes | View, check_cancelled: CheckCancelled = lambda: None) -> Diagnosis:
        return self.diagnosed(read_view(data, self.body, check_cancelled), check_cancelled)

    def diagnosed(self, view: DepthView, check_cancelled: CheckCancelled = lambda: None) -> Diagnosis:
        try:
            cheap = self.examined(view, check_cancelled).findings
        except ImageError as error:
            seen, remedy = f"{error.what}: {error.got}", str(error.remedy)
            blind = Finding("nothing-in-reach", seen, "it is refused", remedy)
            cheap = (blind, *view_findings(self.body, self.sensor, view))
        return diagnose(self.body, self.sensor, view, cheap, check_cancelled)

    def _each(
        self, view: DepthView, check_cancelled: CheckCancelled, known: Any = None
    ) -> list[NDArray[np.uint8]]:
        arm, explained = (self.body, None) if known is None else (known.arm, known.explains)
        found = []
        for picture, camera, state in zip(view.pictures, view.cameras, view.states, strict=True):
            check_cancelled()
            spheres = None if state is None else arm.spheres_at(state)
            found.append(observe(picture, camera, self.sensor.grid, spheres, explained))
        return found

    def grid_arm(self, groups: int) -> GridArm:
        found, arm, grid = grouped(self.body, groups), self.body, self.sensor.grid
        if any(count % NETWORK_MULTIPLE for count in grid.counts):
            raise ScenarioError(
                "networks cannot read arrays of this size",
                expected=f"multiples of {NETWORK_MULTIPLE}",
                got=str(grid.counts),
            )
        moving = np.flatnonzero(found.links > 0)
        return GridArm(
            origins=np.stack([joint.origin.matrix() for joint in arm.joints]),
            axes=np.asarray([joint.axis for joint in arm.joints]),
            spheres_m=arm.spheres_m(),
            own_radii_m=arm.own_radii_m(),
            links=arm.sphere_links(),
            touching=touching_sets(arm),
            group_spheres_m=found.spheres_m[moving],
            group_links=found.links[moving],
            members=found.members[moving],
            low_m=np.asarray(grid.low_m),
            voxel_m=grid.voxel_m,
            distance_step_m=DISTANCE_STEP_M,
            no_reading=NO_READING,
        )

    def check_scenes(self, arrays: Arrays, count: int) -> None:
        for name, values in (("boxes", BOX_VALUES), ("cylinders", CYLINDER_VALUES)):
            array = arrays.get(name, np.empty((count, 0, values)))
            if array.dtype != np.float64 or array.ndim != 3 or array.shape[::2] != (count, values):
                expected, got = f"float64 ({count}, any, {values})", f"{array.dtype} {array.shape}"
                raise DatasetError(f"{name}.npy does not fit", expected=expected, got=got)

    def to_dict(self) -> dict[str, Any]:
        scenes = None if self.scenes is None else self.scenes.to_dict()
        return {
            "kind": self.kind,
            "robot": self.body.to_dict(),
            "cameras": self.sensor.to_dict(),
            "scenes": scenes,
        }


def usual(arm: SerialArm) -> SpatialWorld:
    """An arm that is seen and stands in scenes as most are."""
    return SpatialWorld(arm, DepthSensor(grid_of(arm)), SpatialScenes(base_m=arm.usual_base_m))


def shipped(name: str) -> SerialArm:
    """A robot that comes with the project."""
    path = _ROBOTS / f"{name}.json"
    if not path.is_file():
        known = sorted(one.stem for one in _ROBOTS.glob("*.json"))
        raise ScenarioError(
            "the robot is unknown",
            expected=f"one of {', '.join(known)}, or a file that python -m training.robots import wrote",
            got=name[:200],
        )
    return SerialArm.from_dict(json.loads(path.read_bytes()))


# What a configuration says of such a world, and the worlds that commands can name.
PARTS = {"body": (SerialArm,), "sensor": (DepthSensor,), "scenes": (SpatialScenes,)}
EXAMPLES = {name: usual(shipped(name)) for name in ("panda", "ur5")}


def read(values: Mapping[str, Any]) -> SpatialWorld:
    """The inverse of :meth:`SpatialWorld.to_dict`."""
    parts = read_object(_Parts, values, "the world", ScenarioError)
    return SpatialWorld(SerialArm.from_dict(parts.robot), parts.cameras, parts.scenes)


@validated(ScenarioError)
class _Parts:
    robot: Any
    cameras: DepthSensor
    scenes: SpatialScenes | None


_MAX_BYTES = 2**20


def named(text: str) -> SpatialWorld:
    """The usual world of an arm that ships, by its name, or of one in a file."""
    path = Path(text)
    if not path.is_file():
        return usual(shipped(text))
    data = read_bounded(path, _MAX_BYTES, ConfigError)
    return usual(SerialArm.from_dict(read_json(data, str(path), ConfigError)))
