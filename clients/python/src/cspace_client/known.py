"""What is known of a scene beside its pictures: bodies, what the arm holds, and a converter from MoveIt."""

import struct
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cspace_client.errors import SamplerError

# shape_msgs/SolidPrimitive, by number and as MotionBenchMaker's files write it; names of the dimensions.
_TYPES = {1: "box", 2: "sphere", 3: "cylinder"}
_DIMENSIONS = {"box": 3, "sphere": 1, "cylinder": 2}
# Of a binary STL.
_TRIANGLE = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attributes", "<u2")])
_ADD = (0, "add", b"\x00")


@dataclass(frozen=True, slots=True)
class Known:
    """What is known beside the pictures, with the fields of :class:`cspace_client.wire.KnownFields`.

    ``meshes`` holds binary STL files, as bytes, by the names that bodies give.
    """

    scene: Sequence[Mapping[str, Any]] = ()
    attached: Sequence[Mapping[str, Any]] = ()
    allowed: Sequence[tuple[str, str]] = ()
    ignore: Sequence[Mapping[str, Any]] = ()
    meshes: Mapping[str, bytes] = field(default_factory=dict)

    @property
    def fields(self) -> dict[str, Any]:
        """The fields that are not empty, but the meshes."""
        bodies = {name: getattr(self, name) for name in ("scene", "attached", "ignore")}
        found: dict[str, Any] = {
            name: [dict(one) for one in given] for name, given in bodies.items() if given
        }
        return found | ({"allowed": list(self.allowed)} if self.allowed else {})

    @classmethod
    def of_moveit(cls, planning_scene: Mapping[str, Any], base: str | None = None) -> "Known":
        """Reads a ``moveit_msgs/PlanningScene`` as a mapping, or a scene file of MotionBenchMaker.

        An object of several shapes becomes several bodies: the second of ``shelf`` is ``shelf/1``.

        Args:
            planning_scene: with ``world``, ``robot_state`` and ``allowed_collision_matrix`` or some of them,
                as ``rosidl_runtime_py.message_to_ordereddict`` writes it or YAML is read.
            base: the frame that poses are in; None takes every frame for the base's.
        """
        meshes: dict[str, bytes] = {}
        scene: list[dict[str, Any]] = []
        attached: list[dict[str, Any]] = []
        names: dict[str, list[str]] = {}
        for one in _each(planning_scene, "world", "collision_objects"):
            if one.get("operation", 0) in _ADD:
                bodies = list(_bodies(one, base, meshes))
                names[str(one.get("id"))] = [body["name"] for body in bodies]
                scene += bodies
        for held in _each(planning_scene, "robot_state", "attached_collision_objects"):
            link = str(held.get("link_name"))
            bodies = list(_bodies(held.get("object") or {}, link, meshes))
            names[str((held.get("object") or {}).get("id"))] = [body["name"] for body in bodies]
            more = {"link": link, "touch_links": [str(name) for name in held.get("touch_links") or ()]}
            attached += [body | more for body in bodies]
        allowed = [
            (first, second)
            for one, other in _allowed(planning_scene.get("allowed_collision_matrix") or {})
            if one in names or other in names
            for first in names.get(one, [one])
            for second in names.get(other, [other])
        ]
        return cls(scene, attached, allowed, (), meshes)


def _each(values: Mapping[str, Any], *keys: str) -> Sequence[Mapping[str, Any]]:
    found: Any = values
    for key in keys:
        found = (found or {}).get(key)
    return found or ()


def _bodies(one: Mapping[str, Any], frame: str | None, meshes: dict[str, bytes]) -> Iterator[dict[str, Any]]:
    """The bodies of a collision object, poses in its frame."""
    name, stands_in = str(one.get("id")), (one.get("header") or {}).get("frame_id", "")
    if frame is not None and stands_in not in ("", frame):
        raise SamplerError(
            f"the object {name} is in another frame",
            expected=frame,
            got=str(stands_in),
            remedy="transform its pose first",
        )
    own = _matrix(one.get("pose"))
    solids = zip(one.get("primitives") or (), one.get("primitive_poses") or (), strict=False)
    shapes = [(_solid(name, solid), pose) for solid, pose in solids]
    triangles = zip(one.get("meshes") or (), one.get("mesh_poses") or (), strict=False)
    for number, (mesh, pose) in enumerate(triangles):
        file = f"{name}-{number}.stl"
        meshes[file] = _stl(mesh)
        shapes.append(({"mesh": {"file": file}}, pose))
    if not shapes or one.get("planes"):
        raise SamplerError(
            f"the object {name} has no shape that can be sent",
            expected="primitives with primitive_poses, or meshes with mesh_poses",
            got="planes" if one.get("planes") else "none",
        )
    for number, (shape, pose) in enumerate(shapes):
        placed = (own @ _matrix(pose)).tolist()
        yield {"name": name if number == 0 else f"{name}/{number}", **shape, "pose": placed}


def _stl(mesh: Mapping[str, Any]) -> bytes:
    """A binary STL file of a ``shape_msgs/Mesh``."""
    vertices = np.array([[row[axis] for axis in "xyz"] for row in mesh["vertices"]], dtype=np.float64)
    corners = vertices[np.array([row["vertex_indices"] for row in mesh["triangles"]], dtype=np.int64)]
    rows = np.zeros(len(corners), dtype=_TRIANGLE)
    rows["corners"] = corners
    return b"cspace".ljust(80, b" ") + struct.pack("<I", len(rows)) + rows.tobytes()


def _solid(name: str, solid: Mapping[str, Any]) -> dict[str, Any]:
    kind = solid.get("type")
    kind = _TYPES.get(kind, kind) if isinstance(kind, int) else str(kind).lower()
    sizes = [float(value) for value in solid.get("dimensions") or ()]
    if len(sizes) != _DIMENSIONS.get(str(kind), -1):
        raise SamplerError(
            f"the object {name} has a shape that cannot be sent",
            expected="a box, cylinder or sphere with its dimensions",
            got=f"{kind} of {sizes}",
            remedy="send a mesh of it",
        )
    if kind == "box":
        return {"box": {"size_m": sizes}}
    if kind == "sphere":
        return {"sphere": {"radius_m": sizes[0]}}
    return {"cylinder": {"length_m": sizes[0], "radius_m": sizes[1]}}


def _matrix(pose: Any) -> NDArray[np.float64]:
    """(4, 4) of a ``geometry_msgs/Pose``, or of position and orientation (x, y, z, w) as lists."""
    found = np.eye(4)
    if pose is None:
        return found
    place, turn = (_row(pose.get(key), axes) for key, axes in (("position", "xyz"), ("orientation", "xyzw")))
    if place is not None:
        found[:3, 3] = place
    # A message that nobody filled in has only zeros.
    if turn is not None and np.linalg.norm(turn) > 0.0:
        x, y, z, w = turn / np.linalg.norm(turn)
        found[:3, :3] = [
            [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
            [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
            [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
        ]
    return found


def _row(values: Any, axes: str) -> NDArray[np.float64] | None:
    if values is None:
        return None
    row = [values[axis] for axis in axes] if isinstance(values, Mapping) else values
    return np.asarray(row, dtype=np.float64)


def _allowed(matrix: Mapping[str, Any]) -> Iterator[tuple[str, str]]:
    names = [str(name) for name in matrix.get("entry_names") or ()]
    for at, row in enumerate(matrix.get("entry_values") or ()):
        for other in range(at + 1, len(names)):
            if row["enabled"][other]:
                yield names[at], names[other]
