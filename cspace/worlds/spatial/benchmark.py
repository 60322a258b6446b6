"""Problems of an arm that depth cameras see in part: MotionBenchMaker's, and the world's own."""

import gzip
import json
import zlib
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path
from typing import Annotated, cast

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from cspace.errors import DatasetError, ImageError, ScenarioError
from cspace.files import Record, parse_json, read_object, replacing, validated
from cspace.simulator import Problem, ProblemRequest, Split, UnseenPolicy
from cspace.world import Image, World
from cspace.worlds.spatial.arm import SerialArm
from cspace.worlds.spatial.collision import CollisionChecker, seen_checkers
from cspace.worlds.spatial.furniture import FAMILIES, GoalRegion, Layout
from cspace.worlds.spatial.mesh_checker import MeshChecker, RobotMeshes, panda_urdf
from cspace.worlds.spatial.obstacles import Box, Obstacles
from cspace.worlds.spatial.poses import pose_of, vector
from cspace.worlds.spatial.problems import draw_problem
from cspace.worlds.spatial.scenes import SpatialScene, scenes_of, seen
from cspace.worlds.spatial.sensor import FREE
from cspace.worlds.spatial.world import SpatialWorld, shipped

BENCH_FAMILIES = (
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
_FETCH = "python -m training.motionbench fetch --out FOLDER"
SHIPPED = Path(__file__).with_name("motionbench")
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
UR5, _UR5_JOINTS = "ur5-robotiq", 6
"""Name of the UR5 with its gripper, whose problems and description come with the fetched archive."""
# Half the size of the region that a goal stands for, m.
_GOAL_HALF_M = 0.01


@validated(ScenarioError)
class BenchProblem(Record):
    """A problem of an arm."""

    family: Annotated[str, Field(pattern=f"^({'|'.join(BENCH_FAMILIES)})$")]
    number: Annotated[int, Field(ge=1, le=100)]  # in its family, from 1 to 100
    obstacles: Obstacles
    start: Annotated[tuple[float, ...], Field(min_length=1)]  # (d,) rad
    goal: tuple[float, ...]  # (d,) rad

    def layout(self, arm: SerialArm) -> Layout:
        """The scene, whose one region and whose cameras' focus are where the goal's tool is."""
        tool = arm.tool_frames([self.goal])[0]
        box = Box(pose_of(tool), (_GOAL_HALF_M, _GOAL_HALF_M, _GOAL_HALF_M))
        region = GoalRegion(box, vector(tool[:3, 2] / np.linalg.norm(tool[:3, 2])))
        return Layout(self.family, self.obstacles, (region,), vector(tool[:3, 3]))


@validated(DatasetError)
class _Problems:
    problems: tuple[BenchProblem, ...]


@lru_cache(maxsize=16)
def problems(
    split: Split, folder: Path | None = None, families: tuple[str, ...] = BENCH_FAMILIES
) -> tuple[BenchProblem, ...]:
    """The problems of a split, by family, then by number; validation ships, test comes with ``folder``."""
    if folder is None and split is Split.TEST:
        raise DatasetError("the benchmark's test problems do not ship", remedy=_FETCH)
    path = (folder or SHIPPED) / f"{split.value}.json.gz"
    try:
        values = parse_json(gzip.decompress(path.read_bytes()))
    except (OSError, EOFError, zlib.error, ValueError) as error:
        raise DatasetError(
            "the benchmark's problems cannot be read", got=f"{path}: {error}"[:300], remedy=_FETCH
        ) from error
    found = read_object(_Problems, values, str(path), DatasetError).problems
    by_name = {(one.family, one.number): one for one in found}
    if set(by_name) != set(expected_names(split)):
        expected = f"numbers {NUMBERS[split][0]} to {NUMBERS[split][-1]} of each family"
        raise DatasetError(f"{path} holds other problems", expected=expected, got=f"{len(found)} problems")
    return tuple(by_name[name] for name in expected_names(split) if name[0] in families)


def expected_names(split: Split) -> list[tuple[str, int]]:
    """Family and number of each problem of a split, in order."""
    return [(family, number) for family in BENCH_FAMILIES for number in NUMBERS[split]]


def write_problems(folder: Path, split: Split, found: Iterable[BenchProblem]) -> Path:
    """Write a split's problems where :func:`problems` reads them."""
    text = json.dumps({"problems": [one.to_dict() for one in found]}, separators=(",", ":"), allow_nan=False)
    path = folder / f"{split.value}.json.gz"
    with replacing(path, "the benchmark") as beside:
        path.parent.mkdir(parents=True, exist_ok=True)
        beside.write_bytes(gzip.compress(text.encode("utf-8"), mtime=0))
    return path


PREFIX = "motionbench_"
# Of MotionBenchMaker's Panda, m.
FINGERS_M = 0.065


@dataclass(frozen=True, slots=True)
class SpatialPartlySeen:
    """Planning problems of an arm that pictures show in part, by family."""

    world: SpatialWorld

    @property
    def sources(self) -> dict[str, tuple[str, ...]]:
        """MotionBenchMaker's sets, of the Panda and a UR5 with a gripper, and the world's own families."""
        bench = {"MotionBenchMaker": tuple(PREFIX + family for family in BENCH_FAMILIES)}
        return (bench if has_problems(self.world.body) else {}) | {"own families": FAMILIES}

    @property
    def hard(self) -> tuple[str, ...]:
        return tuple(PREFIX + family for family in ("bookshelf_thin", "bookshelf_tall", "cage", "box"))

    def count(self, family: str, split: Split) -> int | None:
        return len(NUMBERS[split]) if family.startswith(PREFIX) else None

    def problem(self, request: ProblemRequest, family: str, index: int, pictures: int) -> Problem | None:
        """A problem, seen in so many pictures; None where an end collides or nothing in reach is seen."""
        world = with_benchmark_limits(self.world) if family.startswith(PREFIX) else self.world
        layout, start, goal, number = _found(world, request, family, index)
        ends = np.array([start, goal])
        if not CollisionChecker(world.body, layout.obstacles).valid_batch(ends).all():
            return None
        rng = np.random.default_rng([25, pictures, *family.removeprefix(PREFIX).encode(), *number])
        scene = from_both_sides(rng, viewed(world, pictures), layout, ends[0])
        try:
            world.examined(scene.view())
        except ImageError:
            return None
        return Problem(scene, ends[0], ends[1], family, seed=request.seed)

    def checkers(self, problem: Problem, image: Image, taken: UnseenPolicy) -> Sequence[CollisionChecker]:
        """Where unseen space is occupied, room is made for the arm at the start, where it stands."""
        scene = cast("SpatialScene", problem.scenario)
        world, obstacles = scene.world, scene.obstacles
        if taken is UnseenPolicy.KNOWN:
            return [CollisionChecker(world.body, obstacles)]
        ends = np.array([problem.start, problem.goal])
        if taken is UnseenPolicy.TRUE:
            return seen_checkers(world, image, ends, obstacles)
        if taken is UnseenPolicy.FREE:
            return seen_checkers(world, image, ends)
        occupied = image.copy()
        occupied[image[..., 1] != FREE, 0] = 0
        return seen_checkers(world, occupied, ends if taken is UnseenPolicy.CLEARED else ends[:1])

    def mesh_checker(self, problem: Problem, folder: Path | None = None) -> MeshChecker | None:
        """By meshes of the arms that have problems; None for others."""
        scene = cast("SpatialScene", problem.scenario)
        meshes = _meshes(scene.world.body, folder)
        return None if meshes is None else meshes.among(scene.obstacles)


def open_partly_seen(world: World) -> SpatialPartlySeen:
    """Of a world of this kind."""
    return SpatialPartlySeen(cast("SpatialWorld", world))


def is_benchmarked(arm: SerialArm) -> bool:
    """Whether it is MotionBenchMaker's Panda: its joints but for limits, its spheres and its tool."""
    if arm.dim != len(LIMITS_RAD):
        return False
    mine, panda = (one.with_limits(LIMITS_RAD) for one in (arm, shipped("panda")))
    spheres = [[(part.link, part.spheres_m) for part in one.parts] for one in (mine, panda)]
    return (mine.joints, mine.tool) == (panda.joints, panda.tool) and spheres[0] == spheres[1]


def has_problems(arm: SerialArm) -> bool:
    """Whether sets of MotionBenchMaker are for it: its Panda, or :data:`UR5` as the archive describes it."""
    return is_benchmarked(arm) or (arm.name == UR5 and arm.dim == _UR5_JOINTS)


def with_benchmark_limits(world: SpatialWorld) -> SpatialWorld:
    """The Panda's world with the limits of MotionBenchMaker's problems; others as they are."""
    if not is_benchmarked(world.body):
        return world
    return replace(world, body=world.body.with_limits(LIMITS_RAD))


def viewed(world: SpatialWorld, pictures: int) -> SpatialWorld:
    """The world with so many cameras 1.1 to 1.3 m away and 30 to 60 degrees to a side."""
    views = replace(
        world.sensor.views,
        count=(pictures, pictures),
        side_deg=(30.0, 60.0),
        up_deg=(20.0, 40.0),
        distance_m=(1.1, 1.3),
        field_deg=(70.0, 70.0),
    )
    return replace(world, sensor=replace(world.sensor, views=views, holes=0.0))


def from_both_sides(
    rng: np.random.Generator, world: SpatialWorld, layout: Layout, state: NDArray[np.float64]
) -> SpatialScene:
    """A layout as cameras see it that do not all stand on the same side of the line to what they look at."""
    focus = np.asarray(layout.focus)[:2]
    while True:
        scene = seen(rng, world, layout, state)
        places = [np.array(camera.pose)[:2, 3] - focus for camera in scene.cameras]
        sides = {float(np.sign(x * focus[1] - y * focus[0])) for x, y in places}
        if len(places) == 1 or len(sides) > 1:
            return scene


_Found = tuple[Layout, tuple[float, ...], tuple[float, ...], tuple[int, ...]]


@lru_cache(maxsize=4)
def _found(world: SpatialWorld, request: ProblemRequest, family: str, index: int) -> _Found:
    """Scene, start, goal and what pictures of the problem are seeded with."""
    if family.startswith(PREFIX):
        one = problems(request.split, request.folder, (family.removeprefix(PREFIX),))[index]
        return one.layout(world.body), one.start, one.goal, (one.number,)
    problem = draw_problem(world.body, scenes_of(world), request.split, request.seed, index, family)
    start, goal = (tuple(float(angle) for angle in end) for end in (problem.start, problem.goal))
    return problem.layout, start, goal, (*request.split.encode(), request.seed, index)


@lru_cache(maxsize=2)
def _meshes(arm: SerialArm, folder: Path | None) -> RobotMeshes | None:
    urdf = panda_urdf()
    try:
        if is_benchmarked(arm) and urdf is not None:
            return RobotMeshes(
                arm, urdf, dict.fromkeys(("panda_finger_joint1", "panda_finger_joint2"), FINGERS_M)
            )
        if arm.name == UR5 and folder is not None:
            place = folder / "description"
            return RobotMeshes(arm, place / "ur5.urdf", packages=(place,))
    except (ScenarioError, ValueError):
        # Without Pinocchio, or a file of the description.
        return None
    return None
