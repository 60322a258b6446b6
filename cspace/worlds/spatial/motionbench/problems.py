"""The seven sets of a hundred problems: those that may decide ship here, the others are for tests alone."""

import gzip
import json
import zlib
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from cspace.errors import DatasetError, ScenarioError
from cspace.files import replacing
from cspace.splits import Split
from cspace.strict_json import parse_json, read_members, read_object, settle, written
from cspace.worlds.spatial.obstacles.layout import GoalRegion, Layout
from cspace.worlds.spatial.obstacles.shapes import Box, Obstacles
from cspace.worlds.spatial.poses import Vector, pose_of
from cspace.worlds.spatial.robot.arm import SerialArm

FAMILIES = (
    "bookshelf_small",
    "bookshelf_tall",
    "bookshelf_thin",
    "box",
    "cage",
    "table_pick",
    "table_under_pick",
)
# Of the hundred in each family.
NUMBERS = {Split.VALIDATION: range(1, 31), Split.TEST: range(31, 101)}
SHIPPED = Path(__file__).parent
# Of the Panda's joints in the benchmark, wider than its maker's; some starts and goals need them.
LIMITS_RAD = (
    (-2.9671, 2.9671),
    (-1.8326, 1.8326),
    (-2.9671, 2.9671),
    (-3.1416, 0.0873),
    (-2.9671, 2.9671),
    (-0.0873, 3.8223),
    (-2.9671, 2.9671),
)
# Half the size of the region that a goal stands for, m.
_GOAL_HALF_M = 0.01


@dataclass(frozen=True, slots=True)
class BenchProblem:
    """A problem of the Panda.

    Args:
        family: one of ``FAMILIES``.
        number: in its family, from 1 to 100.
        obstacles: in the base frame.
        start: (d,) rad.
        goal: (d,) rad.

    Raises:
        ScenarioError: the family is unknown, the number is out of range, or start and goal do not fit.
    """

    family: str
    number: int
    obstacles: Obstacles
    start: tuple[float, ...]
    goal: tuple[float, ...]

    def __post_init__(self) -> None:
        settle(self)
        if self.family not in FAMILIES or not 1 <= self.number <= 100:
            raise ScenarioError(
                "a benchmark's problem is unknown",
                expected=f"1 to 100 of {', '.join(FAMILIES)}",
                got=f"{self.number} of {self.family!r}"[:200],
            )
        if not self.start or len(self.start) != len(self.goal):
            raise ScenarioError(
                "start and goal do not fit",
                expected="as many joints of both",
                got=f"{len(self.start)} and {len(self.goal)}",
            )

    @property
    def split(self) -> Split:
        """What the problem may be used for."""
        return Split.VALIDATION if self.number in NUMBERS[Split.VALIDATION] else Split.TEST

    def layout(self, arm: SerialArm) -> Layout:
        """The scene, whose one region and whose cameras' focus are where the goal's tool is.

        Raises:
            ScenarioError: the arm has another number of joints.
        """
        tool = arm.tool_frames([self.goal])[0]
        box = Box(pose_of(tool), (_GOAL_HALF_M, _GOAL_HALF_M, _GOAL_HALF_M))
        region = GoalRegion(box, _vector(tool[:3, 2] / np.linalg.norm(tool[:3, 2])))
        return Layout(self.family, self.obstacles, (region,), _vector(tool[:3, 3]))

    def to_dict(self) -> dict[str, Any]:
        """Plain values for JSON."""
        return written(self)


def problems(
    split: Split, folder: Path | None = None, families: Iterable[str] = FAMILIES
) -> tuple[BenchProblem, ...]:
    """The problems of a split, by family, then by number.

    Args:
        split: validation, numbers 1 to 30, or test, 31 to 100, which nothing is ever tuned on.
        folder: that ``python -m training.motionbench fetch`` filled; validation problems are read from where
            they ship unless it is given.
        families: some of ``FAMILIES``.

    Raises:
        DatasetError: the split has none, a file is missing, is damaged or holds other problems.
        ScenarioError: a family is unknown.
    """
    if split not in NUMBERS:
        raise DatasetError("the benchmark has no such split", expected="validation or test", got=str(split))
    wanted = tuple(families)
    if unknown := sorted(set(wanted) - set(FAMILIES)):
        raise ScenarioError(
            "families are unknown", expected=f"some of {', '.join(FAMILIES)}", got=str(unknown)[:200]
        )
    if folder is None and split is Split.TEST:
        raise DatasetError(
            "the benchmark's test problems do not ship",
            expected="a folder that holds them",
            got="none",
            remedy="python -m training.motionbench fetch --out FOLDER",
        )
    found = read_problems(_file(SHIPPED if folder is None else folder, split))
    if {(one.family, one.number) for one in found} != expected_names(split):
        raise DatasetError(
            "the benchmark's file holds other problems",
            expected=f"numbers {NUMBERS[split][0]} to {NUMBERS[split][-1]} of each family",
            got=f"{len(found)} problems",
        )
    return tuple(one for one in found if one.family in wanted)


def expected_names(split: Split) -> set[tuple[str, int]]:
    """Family and number of each problem of a split."""
    return {(family, number) for family in FAMILIES for number in NUMBERS[split]}


def read_problems(path: Path) -> tuple[BenchProblem, ...]:
    """What :func:`write_problems` wrote.

    Raises:
        DatasetError: there is no such file, or it holds something else.
    """
    try:
        values = parse_json(gzip.decompress(path.read_bytes()))
    except (OSError, EOFError, zlib.error, ValueError) as error:
        raise _bad(path, str(error)) from error
    try:
        listed = read_members(values, {"problems"}, "the benchmark", DatasetError)["problems"]
        if not isinstance(listed, list):
            raise _bad(path, "no list of problems")
        found = tuple(read_object(BenchProblem, one, "a problem", DatasetError) for one in listed)
    except ScenarioError as error:
        raise _bad(path, str(error)) from error
    if len({(one.family, one.number) for one in found}) != len(found):
        raise _bad(path, "a problem twice")
    return tuple(sorted(found, key=lambda one: (FAMILIES.index(one.family), one.number)))


def write_problems(folder: Path, split: Split, found: Iterable[BenchProblem]) -> Path:
    """Write a split's problems where :func:`problems` reads them.

    Raises:
        StorageError: the file cannot be written.
    """
    text = json.dumps({"problems": [one.to_dict() for one in found]}, separators=(",", ":"), allow_nan=False)
    path = _file(folder, split)
    with replacing(path, "the benchmark") as beside:
        path.parent.mkdir(parents=True, exist_ok=True)
        beside.write_bytes(gzip.compress(text.encode("utf-8"), mtime=0))
    return path


def _file(folder: Path, split: Split) -> Path:
    return folder / f"{split.value}.json.gz"


def _vector(values: Any) -> Vector:
    x, y, z = (float(value) for value in values)
    return (x, y, z)


def _bad(path: Path, got: str) -> DatasetError:
    return DatasetError(
        "the benchmark's problems cannot be read",
        expected="the file that python -m training.motionbench fetch writes",
        got=f"{path}: {got}"[:300],
        remedy="python -m training.motionbench fetch --out FOLDER",
    )
