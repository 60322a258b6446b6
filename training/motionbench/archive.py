"""Problems out of the source archive of vamp-planner, in the project's form."""

import hashlib
import io
import re
import tarfile
import zlib
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path, PurePosixPath
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cspace.errors import CspaceError, DamagedFileError, DatasetError, ScenarioError
from cspace.files import replacing
from cspace.simulator import Split
from cspace.worlds.spatial.benchmark import NUMBERS, BenchProblem, expected_names
from cspace.worlds.spatial.obstacles import Box, Cylinder, Obstacles
from cspace.worlds.spatial.poses import Pose, pose_of, quaternion_pose
from cspace.yaml_file import read_yaml

PACKAGE, VERSION = "vamp-planner", "0.6.4"
# Of the archive that the problems were first taken from.
SHA256 = "d3150c6b67ff941af9ad56480b31d3fb73b12211ea21dc684f7737b059f6daba"
_RESOURCES = f"vamp_planner-{VERSION}/resources"
JOINTS = {
    "panda": tuple(f"panda_joint{number}" for number in range(1, 8)),
    "ur5": tuple(
        f"{name}_joint"
        for name in ("shoulder_pan", "shoulder_lift", "elbow", "wrist_1", "wrist_2", "wrist_3")
    ),
}
"""Of the robots whose problems are read."""
# Of places, m, angles, rad, and what turns are made of.
_DIGITS = 6


def read_archive(archive: Path, sha256: str, robot: str = "panda") -> dict[Split, tuple[BenchProblem, ...]]:
    """All problems of a robot in an archive by what they may be used for, numbers rounded to 1e-6.

    Args:
        archive: the package's source archive.
        sha256: that it has to have.
        robot: one of ``JOINTS``.

    Raises:
        DamagedFileError: its digest is another.
        DatasetError: it cannot be read, or holds other problems.
    """
    try:
        data = archive.read_bytes()
    except OSError as error:
        raise _bad(f"{archive}: {error.strerror}") from error
    if (found := hashlib.sha256(data).hexdigest()) != sha256:
        raise DamagedFileError(
            "the benchmark's archive is damaged or another",
            expected=f"{PACKAGE} {VERSION} with the SHA-256 sum {sha256}",
            got=found,
        )
    try:
        texts = dict(_texts(data, robot))
        read = [
            _problem(texts, family, number, JOINTS[robot])
            for family, kind, number in texts
            if kind == "scene"
        ]
    except (tarfile.TarError, zlib.error, OSError, EOFError) as error:
        raise _bad(f"{type(error).__name__}: {error}") from error
    result = {}
    for split, numbers in NUMBERS.items():
        result[split] = tuple(sorted((one for one in read if one.number in numbers), key=_place))
        if {_place(one) for one in result[split]} != set(expected_names(split)):
            raise _bad(f"{len(read)} problems")
    return result


def unpack_description(archive: Path, robot: str, folder: Path) -> Path:
    """Unpack a robot's URDF, SRDF and meshes, of an archive whose sum was checked; the URDF's path.

    What the folder holds already is left.

    Raises:
        StorageError: the folder cannot be written.
    """
    if folder.is_dir():
        return folder / f"{robot}.urdf"
    with replacing(folder, "the description") as beside:
        beside.mkdir(parents=True)
        with tarfile.open(archive, mode="r:gz") as outer:
            for member in outer:
                inside = PurePosixPath(member.name)
                within = inside.is_relative_to(f"{_RESOURCES}/{robot}") and inside.suffix != ".bz2"
                if member.isfile() and within:
                    path = beside / inside.relative_to(f"{_RESOURCES}/{robot}")
                    path.parent.mkdir(parents=True, exist_ok=True)
                    outer.extract(member.replace(name=path.name), path.parent, filter="data")
    return folder / f"{robot}.urdf"


def _texts(data: bytes, robot: str) -> Iterator[tuple[tuple[str, str, int], bytes]]:
    """What the files of problems hold, by family, kind and number."""
    inside = f"{_RESOURCES}/{robot}/problems.tar.bz2"
    named_so = re.compile(rf"problems/(\w+)_{robot}/(scene|request)(\d{{4}})\.yaml")
    with tarfile.open(fileobj=io.BytesIO(data), mode="r:gz") as outer:
        try:
            packed = outer.extractfile(inside)
        except KeyError:
            packed = None
        if packed is None:
            raise _bad(f"no {inside}")
        with tarfile.open(fileobj=io.BytesIO(packed.read()), mode="r:bz2") as inner:
            for member in inner:
                named, file = named_so.fullmatch(member.name), inner.extractfile(member)
                if named is not None and file is not None:
                    yield (named[1], named[2], int(named[3])), file.read()


def _problem(
    texts: Mapping[tuple[str, str, int], bytes], family: str, number: int, joints: Sequence[str]
) -> BenchProblem:
    try:
        scene, request = (
            read_yaml(texts[family, kind, number], f"{kind}{number:04d}.yaml", DatasetError)
            for kind in ("scene", "request")
        )
        state = request["start_state"]["joint_state"]
        start = dict(zip(state["name"], state["position"], strict=True))
        wanted = request["goal_constraints"][0]["joint_constraints"]
        goal = {one["joint_name"]: one["position"] for one in wanted}
        return BenchProblem(
            family,
            number,
            Obstacles.of([_shape(one) for one in scene["world"]["collision_objects"]]),
            tuple(round(float(start[name]), _DIGITS) for name in joints),
            tuple(round(float(goal[name]), _DIGITS) for name in joints),
        )
    except (KeyError, IndexError, TypeError, ValueError) as error:
        # Its own errors say more.
        got = str(error) if isinstance(error, CspaceError) else f"{type(error).__name__} {error}"
        raise _bad(f"{family} {number}: {got}") from error


def _shape(listed: Mapping[str, Any]) -> Box | Cylinder:
    (primitive,), (place,) = listed["primitives"], listed["primitive_poses"]
    pose = _pose(place) if "pose" not in listed else _pose(listed["pose"]) @ _pose(place)
    sizes = [float(size) for size in primitive["dimensions"]]
    if primitive["type"] == "box":
        x, y, z = (round(size / 2.0, _DIGITS) for size in sizes)
        return Box(_rounded(pose), (x, y, z))
    if primitive["type"] == "cylinder":
        length, radius = sizes
        return Cylinder(_rounded(pose), round(radius, _DIGITS), round(length / 2.0, _DIGITS))
    raise ScenarioError("a shape is unknown", expected="box or cylinder", got=repr(primitive["type"])[:200])


def _pose(listed: Mapping[str, Any]) -> NDArray[np.float64]:
    return quaternion_pose(listed["position"], listed["orientation"])


def _rounded(pose: NDArray[np.float64]) -> Pose:
    # Minus zero is zero.
    return pose_of(np.round(pose, _DIGITS) + 0.0)


def _place(problem: BenchProblem) -> tuple[str, int]:
    return (problem.family, problem.number)


def _bad(got: str) -> DatasetError:
    return DatasetError(
        "the benchmark's archive cannot be read",
        expected=f"the source archive of {PACKAGE} {VERSION} with a hundred problems in each family",
        got=got[:300],
    )
