"""Collision checks of a serial arm by the meshes of its description, with Pinocchio and coal."""

from collections.abc import Mapping, Sequence
from importlib.metadata import PackageNotFoundError, files
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from cspace.errors import ScenarioError
from cspace.worlds.spatial.arm import SerialArm
from cspace.worlds.spatial.obstacles import Box, Obstacles
from cspace.worlds.spatial.poses import nearest_rotation


class RobotMeshes:
    """The meshes of an arm, loaded once for the checkers of many scenes, as its description has them.

    ``locked`` holds values of joints that do not move, rad or m; packages that meshes are named in are looked
    for in ``packages``, then in the folders above the file.
    """

    def __init__(
        self,
        arm: SerialArm,
        urdf: Path,
        locked: Mapping[str, float] = MappingProxyType({}),
        packages: Sequence[Path] = (),
    ) -> None:
        self.arm = arm
        self.pin, self._coal = _libraries()
        file, folders = str(urdf.resolve()), [str(one) for one in (*packages, *urdf.resolve().parents)]
        whole = self.pin.buildModelFromUrdf(file)
        kind = self.pin.GeometryType.COLLISION
        geometry = self.pin.buildGeomFromUrdf(whole, file, kind, package_dirs=folders)
        values, numbers = self.pin.neutral(whole), [whole.getJointId(name) for name in locked]
        for number, value in zip(numbers, locked.values(), strict=True):
            joint = whole.joints[number]
            held = value if joint.nq == 1 else (np.cos(value), np.sin(value))
            values[joint.idx_q : joint.idx_q + joint.nq] = held
        self.model, (self.geometry,) = self.pin.buildReducedModel(whole, [geometry], numbers, values)
        joints = [self.model.joints[self.model.getJointId(joint.name)] for joint in arm.joints]
        self._columns = [(joint.idx_q, joint.nq) for joint in joints]
        shapes: dict[str, list[int]] = {part.name: [] for part in arm.parts}
        for index, shape in enumerate(self.geometry.geometryObjects):
            shapes.setdefault(self.model.frames[shape.parentFrame].name, []).append(index)
            mesh = shape.geometry
            if mesh.getObjectType() == self._coal.OBJECT_TYPE.OT_BVH:
                mesh.buildConvexHull(True, "Qt")  # noqa: FBT003 # takes no names
                # Another mesh has vertices inside its hull, and is looked at triangle by triangle.
                if mesh.convex.num_points == mesh.num_vertices:
                    shape.geometry = mesh.convex
        self.pairs = tuple(
            (first, second)
            for one, other in arm.touching
            for first in shapes[one]
            for second in shapes[other]
        )

    def among(self, obstacles: Obstacles) -> "MeshChecker":
        return MeshChecker(self, obstacles)

    def configuration(self, row: NDArray[np.float64]) -> NDArray[np.float64]:
        """Of the arm, (d,) rad, as the model has it: continuous joints by cosine and sine."""
        found = np.zeros(self.model.nq)
        for angle, (column, width) in zip(row, self._columns, strict=True):
            found[column : column + width] = (angle,) if width == 1 else (np.cos(angle), np.sin(angle))
        return found

    def with_obstacles(self, obstacles: Obstacles) -> Any:
        """A copy of the geometry in which every shape that moves is held apart from each obstacle, too."""
        geometry = self.geometry.copy()
        own = [number for number, one in enumerate(geometry.geometryObjects) if one.parentJoint > 0]
        pairs = list(self.pairs)
        for number, shape in enumerate(obstacles.shapes):
            pose = np.asarray(shape.pose)
            place = self.pin.SE3(nearest_rotation(pose[:3, :3]), pose[:3, 3])
            if isinstance(shape, Box):
                solid = self._coal.Box(*(2.0 * half for half in shape.half_m))
            else:
                solid = self._coal.Cylinder(shape.radius_m, 2.0 * shape.half_length_m)
            added = self.pin.GeometryObject(f"obstacle {number}", 0, place, solid)
            last = geometry.addGeometryObject(added)
            pairs += [(index, last) for index in own]
        for pair in pairs:
            geometry.addCollisionPair(self.pin.CollisionPair(*pair))
        return geometry


class MeshChecker:
    """Which configurations are free in one scene, whatever the joint limits; for one thread at a time."""

    def __init__(self, meshes: RobotMeshes, obstacles: Obstacles) -> None:
        self._meshes = meshes
        self._geometry = meshes.with_obstacles(obstacles)
        self._data = meshes.model.createData()
        self._shapes = self._geometry.createData()
        # Else coal 3.0 stops early and misses one collision of hulls in some thousands, up to 25 mm deep.
        for request in self._shapes.collisionRequests:
            request.enable_contact = True
        # What it walks are the bounds of shapes in a tree; it keeps references to all three.
        self._broad = meshes.pin.BroadPhaseManager_DynamicAABBTreeCollisionManager(
            meshes.model, self._geometry, self._shapes
        )

    def valid_batch(self, configurations: ArrayLike) -> NDArray[np.bool_]:
        """Whether no two shapes that are held apart meet: (N, d) rad to (N,)."""
        model, data, walk = self._meshes.model, self._data, self._meshes.pin.computeCollisions
        return np.array(
            [
                not walk(model, data, self._broad, self._meshes.configuration(row), True)  # noqa: FBT003
                for row in np.asarray(configurations, dtype=np.float64)
            ],
            dtype=np.bool_,
        )


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
