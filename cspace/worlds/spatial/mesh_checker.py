"""Verdicts by the robot's own collision meshes, with Pinocchio and coal, an extra."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from importlib.metadata import PackageNotFoundError, files
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from cspace.errors import ScenarioError
from cspace.worlds.spatial.arm import SerialArm
from cspace.worlds.spatial.obstacles import Box, Cylinder, Obstacles
from cspace.worlds.spatial.poses import nearest_rotation

# Of the arm's kinematics and the description's, m.
_SAME_M = 1e-6


@dataclass(frozen=True, slots=True)
class Description:
    """Where a robot's meshes are described."""

    urdf: Path  # the file; packages that its meshes are named in are looked for in the folders above it
    locked: Mapping[str, float] = field(default_factory=dict)  # values of joints that do not move, rad or m
    packages: tuple[Path, ...] = ()
    convex: bool = True  # take convex meshes as solids, which is quicker than as hollow surfaces


class RobotMeshes:
    """An arm's meshes, loaded once, for the checkers of many scenes."""

    def __init__(self, arm: SerialArm, description: Description) -> None:
        self.arm = arm
        self._pin, self._coal = _libraries()
        self.model, self.geometry = self._loaded(description)
        self._columns = [self._column(joint.name) for joint in arm.joints]
        shapes: dict[str, list[int]] = {part.name: [] for part in arm.parts}
        for index, shape in enumerate(self.geometry.geometryObjects):
            shapes.setdefault(self.model.frames[shape.parentFrame].name, []).append(index)
            if description.convex:
                self._make_convex(shape)
        if bare := [part.name for part in arm.parts if not shapes[part.name]]:
            raise _bad(description, f"no shapes for the arm's parts {bare}")
        self.pairs = tuple(
            (first, second)
            for one, other in arm.touching
            for first in shapes[one]
            for second in shapes[other]
        )
        self._check_motion(description)

    def among(self, obstacles: Obstacles) -> "MeshChecker":
        """The checker of a scene."""
        return MeshChecker(self, obstacles)

    def configuration(self, row: NDArray[np.float64]) -> NDArray[np.float64]:
        """Of the arm, (d,) rad, as the model has it: continuous joints by cosine and sine."""
        found = np.zeros(self.model.nq)
        for angle, (column, width) in zip(row, self._columns, strict=True):
            found[column : column + width] = (angle,) if width == 1 else (np.cos(angle), np.sin(angle))
        return found

    def places(self, row: NDArray[np.float64]) -> NDArray[np.float64]:
        """Poses (shapes, 4, 4) m of all shapes in the base frame, at a configuration (d,) rad."""
        data, found = self.model.createData(), self.geometry.createData()
        self._pin.updateGeometryPlacements(self.model, data, self.geometry, found, self.configuration(row))
        return np.stack([np.asarray(place.homogeneous) for place in found.oMg])

    def with_obstacles(self, obstacles: Obstacles) -> Any:
        """A copy of the geometry in which every shape that moves is held apart from each obstacle, too."""
        geometry = self.geometry.copy()
        own = [number for number, one in enumerate(geometry.geometryObjects) if one.parentJoint > 0]
        for pair in self.pairs:
            geometry.addCollisionPair(self._pin.CollisionPair(*pair))
        for number, shape in enumerate(obstacles.shapes):
            pose = np.asarray(shape.pose)
            place = self._pin.SE3(nearest_rotation(pose[:3, :3]), pose[:3, 3])
            added = self._pin.GeometryObject(f"obstacle {number}", 0, place, self._shape(shape))
            last = geometry.addGeometryObject(added)
            for index in own:
                geometry.addCollisionPair(self._pin.CollisionPair(index, last))
        return geometry

    def _loaded(self, description: Description) -> tuple[Any, Any]:
        urdf = description.urdf.resolve()
        folders = [str(folder) for folder in (*description.packages, *urdf.parents)]
        try:
            whole = self._pin.buildModelFromUrdf(str(urdf))
            kind = self._pin.GeometryType.COLLISION
            geometry = self._pin.buildGeomFromUrdf(whole, str(urdf), kind, package_dirs=folders)
        except (ValueError, RuntimeError) as error:
            raise _bad(description, str(error)) from error
        names = list(whole.names)
        if unknown := sorted(set(description.locked) - set(names)):
            raise _bad(description, f"no joints {unknown}")
        values = self._pin.neutral(whole)
        for name, value in description.locked.items():
            joint = whole.joints[names.index(name)]
            values[joint.idx_q : joint.idx_q + joint.nq] = (
                value if joint.nq == 1 else (np.cos(value), np.sin(value))
            )
        model, reduced = self._pin.buildReducedModel(
            whole, [geometry], [names.index(name) for name in description.locked], values
        )
        if sorted(model.names[1:]) != sorted(joint.name for joint in self.arm.joints):
            raise _bad(description, f"joints that move {list(model.names)[1:]}")
        return model, reduced[0]

    def _column(self, name: str) -> tuple[int, int]:
        joint = self.model.joints[self.model.getJointId(name)]
        return joint.idx_q, joint.nq

    def _make_convex(self, shape: Any) -> None:
        mesh = shape.geometry
        if mesh.getObjectType() == self._coal.OBJECT_TYPE.OT_BVH:
            mesh.buildConvexHull(True, "Qt")  # noqa: FBT003 # takes no names
            # Another mesh has vertices inside its hull, and is looked at triangle by triangle.
            if mesh.convex.num_points == mesh.num_vertices:
                shape.geometry = mesh.convex

    def _shape(self, shape: Box | Cylinder) -> Any:
        if isinstance(shape, Box):
            return self._coal.Box(*(2.0 * half for half in shape.half_m))
        return self._coal.Cylinder(shape.radius_m, 2.0 * shape.half_length_m)

    def _check_motion(self, description: Description) -> None:
        """That joints of both are at the same places, in three configurations."""
        space, data = self.arm.space, self.model.createData()
        lower, upper = np.asarray(space.lower), np.asarray(space.upper)
        for share in (0.2, 0.5, 0.9):
            row = lower + share * (upper - lower)
            self._pin.forwardKinematics(self.model, data, self.configuration(row))
            own = self.arm.joint_positions_m(row)[0, 1:-1]
            found = [data.oMi[self.model.getJointId(joint.name)].translation for joint in self.arm.joints]
            if (off := np.linalg.norm(own - found, axis=1).max()) > _SAME_M:
                raise _bad(description, f"joints {off:.3g} m away from the arm's")


class MeshChecker:
    """Which configurations are free in one scene, whatever the joint limits; for one thread at a time."""

    def __init__(self, meshes: RobotMeshes, obstacles: Obstacles) -> None:
        self._pin, self._meshes = meshes._pin, meshes  # noqa: SLF001 # one module
        self._geometry = meshes.with_obstacles(obstacles)
        self._data = meshes.model.createData()
        self._shapes = self._geometry.createData()
        # Else coal 3.0 stops early and misses one collision of hulls in some thousands, up to 25 mm deep.
        for request in self._shapes.collisionRequests:
            request.enable_contact = True
        # What it walks are the bounds of shapes in a tree; it keeps references to all three.
        self._broad = self._pin.BroadPhaseManager_DynamicAABBTreeCollisionManager(
            meshes.model, self._geometry, self._shapes
        )

    def valid_batch(self, configurations: ArrayLike) -> NDArray[np.bool_]:
        """Whether no two shapes that are held apart meet: (N, d) rad to (N,)."""
        model, data, walk = self._meshes.model, self._data, self._pin.computeCollisions
        return np.array(
            [
                not walk(model, data, self._broad, self._meshes.configuration(row), True)  # noqa: FBT003
                for row in np.asarray(configurations, dtype=np.float64)
            ],
            dtype=np.bool_,
        )

    def clearance_m(self, configurations: ArrayLike) -> NDArray[np.float64]:
        """Signed distance of the closest shapes held apart: (N, d) rad to (N,) m; inf without such."""
        rows = np.asarray(configurations, dtype=np.float64)
        found = np.full(len(rows), np.inf)
        if len(self._geometry.collisionPairs):
            for index, row in enumerate(rows):
                at = self._meshes.configuration(row)
                model, data = self._meshes.model, self._data
                closest = self._pin.computeDistances(model, data, self._geometry, self._shapes, at)
                found[index] = self._shapes.distanceResults[closest].min_distance
        return found


def panda_urdf() -> Path | None:
    """The Panda's description in the package example-robot-data; None where that is not installed."""
    try:
        listed = files("example-robot-data") or []
    except PackageNotFoundError:
        return None
    ending = "panda_description/urdf/panda.urdf"
    return next((Path(str(one.locate())) for one in listed if str(one).endswith(ending)), None)


def _libraries() -> tuple[Any, Any]:
    try:
        import coal  # noqa: PLC0415 # an extra
        import pinocchio  # noqa: PLC0415 # an extra
    except ImportError as error:
        raise ScenarioError(
            "meshes cannot check",
            expected="the extra spatial",
            got=f"no {error.name}",
            remedy="pip install -c constraints.txt '.[spatial]'",
        ) from error
    return pinocchio, coal


def _bad(description: Description, got: str) -> ScenarioError:
    return ScenarioError(
        "the description does not fit the arm",
        expected="the URDF file that the arm was made of, its meshes, and values for joints held there",
        got=f"{description.urdf}: {got}"[:400],
    )
