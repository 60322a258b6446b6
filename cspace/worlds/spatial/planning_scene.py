"""What a planner knows beside its pictures, in MoveIt's words: world and attached objects, and so on."""

import base64
import struct
from collections.abc import Mapping
from typing import Annotated, Any, cast

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, ValidationError

from cspace.errors import InputError
from cspace.files import Record, adapter_of, project_error, validated
from cspace.view_file import (
    MAX_ATTACHED,
    MAX_BODIES,
    MAX_IGNORED,
    MAX_MESHES,
    MAX_PAIRS,
    MAX_TRIANGLES,
)
from cspace.worlds.spatial.arm import TOOL
from cspace.worlds.spatial.poses import HERE, MAX_PLACE_M, read_pose

MAX_BYTES = 8 * 2**20
_Size = Annotated[float, Field(gt=0.0, le=MAX_PLACE_M)]
_Name = Annotated[str, Field(min_length=1, max_length=100)]
# Of a binary STL.
_TRIANGLE = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attributes", "<u2")])
_SHAPES = ("box", "cylinder", "sphere", "mesh")


@validated(InputError)
class BoxShape(Record):
    """A cuboid of sizes along x, y and z, m."""

    size_m: tuple[_Size, _Size, _Size]


@validated(InputError)
class CylinderShape(Record):
    """A solid cylinder about its own z, centred, m."""

    radius_m: _Size
    length_m: _Size


@validated(InputError)
class SphereShape(Record):
    """A ball, m."""

    radius_m: _Size


@validated(InputError)
class MeshShape(Record):
    """Triangles of a binary STL file that the request carries, times ``scale`` (0.001 for one in mm)."""

    file: _Name
    scale: _Size = 1.0


@validated(InputError)
class Body(Record):
    """A shape with a pose."""

    name: Annotated[str, Field(max_length=100)] = ""
    box: BoxShape | None = None
    cylinder: CylinderShape | None = None
    sphere: SphereShape | None = None
    mesh: MeshShape | None = None
    # Of the shape's centre, or of a mesh's origin, in the base frame: 4 x 4, or translation and quaternion,
    # which become 4 x 4
    pose: Any = HERE

    def __post_init__(self) -> None:
        given = [name for name in _SHAPES if getattr(self, name) is not None]
        if len(given) != 1:
            raise InputError(
                f"the body {self.name!r} has no single shape", expected=f"one of {', '.join(_SHAPES)}"
            )
        pose = self.pose
        if isinstance(pose, Mapping):
            pose = {"quaternion_xyzw": (0.0, 0.0, 0.0, 1.0), **pose}
        object.__setattr__(self, "pose", read_pose(pose, f"the body {self.name!r}", InputError))

    @property
    def matrix(self) -> NDArray[np.float64]:
        return np.asarray(self.pose, dtype=np.float64)


@validated(InputError)
class Attached(Body):
    """A body that moves with the arm."""

    # As :meth:`cspace.worlds.spatial.arm.SerialArm.named_frame` has it; the pose is in its frame
    link: _Name = TOOL
    touch_links: Annotated[tuple[_Name, ...], Field(max_length=100)] = ()


@validated(InputError)
class PlanningScene(Record):
    """What is known."""

    scene: Annotated[tuple[Body, ...], Field(max_length=MAX_BODIES)] = ()
    attached: Annotated[tuple[Attached, ...], Field(max_length=MAX_ATTACHED)] = ()
    allowed: Annotated[tuple[tuple[_Name, _Name], ...], Field(max_length=MAX_PAIRS)] = ()
    ignore: Annotated[tuple[Body, ...], Field(max_length=MAX_IGNORED)] = ()
    # Binary STL files in base64, by the names that shapes give
    meshes: Annotated[dict[_Name, str], Field(max_length=MAX_MESHES)] = Field(default_factory=dict)

    def __post_init__(self) -> None:
        names = [one.name for one in (*self.scene, *self.attached)]
        if "" in names or len(set(names)) != len(names):
            raise InputError("the bodies do not fit", expected="a name each", got=str(names)[:200])
        unknown = {one.mesh.file for one in self.bodies if one.mesh is not None} - set(self.meshes)
        if unknown:
            raise InputError(
                "a body has a mesh that did not come",
                expected=f"one of the files {sorted(self.meshes)}"[:200],
                got=", ".join(sorted(unknown))[:200],
                remedy="send the file as a part `mesh` of a form, or in `meshes` as base64",
            )

    @property
    def bodies(self) -> tuple[Body, ...]:
        return (*self.scene, *self.attached, *self.ignore)

    def corners_m(self) -> dict[str, NDArray[np.float64]]:
        """(T, 3, 3) of the triangles of each mesh, in its own unit."""
        found = {}
        for name, text in self.meshes.items():
            try:
                data = base64.b64decode(text, validate=True)
            except ValueError as error:
                what = f"the mesh {name} is not base64 of a binary STL"
                raise InputError(what, got=text[:50]) from error
            found[name] = read_stl(data, name)
        return found


def read_planning_scene(values: bytes) -> PlanningScene:
    """A planning scene of JSON, and of its meshes."""
    where = "the planning scene"
    if len(values) > MAX_BYTES:
        raise InputError(f"{where} is too large", expected=f"at most {MAX_BYTES} bytes", got=str(len(values)))
    try:
        return cast("PlanningScene", adapter_of(PlanningScene).validate_json(values, strict=True))
    except ValidationError as problem:
        raise project_error(problem, InputError, where) from problem


def read_stl(data: bytes, name: str) -> NDArray[np.float64]:
    """Corners (T, 3, 3) of the triangles of a binary STL file, those without area left out."""
    count = struct.unpack_from("<I", data, 80)[0] if len(data) >= 84 else -1
    if len(data) != 84 + 50 * count:
        raise InputError(
            f"the mesh {name} is no binary STL",
            expected="80 bytes, the number of triangles as uint32, and 50 bytes for each",
            got=f"{len(data)} bytes that begin with {data[:10]!r}",
            remedy="trimesh.load(file, force='mesh').export('part.stl') writes one",
        )
    if not 1 <= count <= MAX_TRIANGLES:
        raise InputError(
            f"the mesh {name} has too many triangles, or none",
            expected=f"1 to {MAX_TRIANGLES}",
            got=str(count),
            remedy="simplify the mesh, or send boxes and cylinders about it",
        )
    corners = np.frombuffer(data, dtype=_TRIANGLE, offset=84)["corners"].astype(np.float64)
    if not np.isfinite(corners).all() or np.abs(corners).max() > 1e6:
        raise InputError(f"the mesh {name} has corners that are no finite numbers")
    sides = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    corners = np.asarray(corners[np.linalg.norm(sides, axis=1) > 0.0])
    if not len(corners):
        raise InputError(f"the mesh {name} has no surface", expected="triangles with an area", got="none")
    return corners
