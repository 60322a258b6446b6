"""Problems of an arm that depth cameras see in part: MotionBenchMaker's of the Panda, and the world's own."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path
from typing import cast

import numpy as np
from numpy.typing import ArrayLike, NDArray

from cspace.errors import ImageError, ScenarioError
from cspace.problem import Problem
from cspace.splits import Split
from cspace.world import Image, World
from cspace.worlds.spatial.motionbench.problems import FAMILIES as BENCH_FAMILIES
from cspace.worlds.spatial.motionbench.problems import LIMITS_RAD, NUMBERS, BenchProblem, problems
from cspace.worlds.spatial.obstacles.layout import Layout
from cspace.worlds.spatial.obstacles.scenes import FAMILIES
from cspace.worlds.spatial.obstacles.shapes import Box, Cylinder, Obstacles
from cspace.worlds.spatial.planning.collision import CollisionChecker
from cspace.worlds.spatial.planning.judge import Description, MeshJudge, RobotMeshes, panda_urdf
from cspace.worlds.spatial.planning.problems import draw_problem
from cspace.worlds.spatial.robot.arm import SerialArm
from cspace.worlds.spatial.robot.kinematics import arm_arrays, sphere_centres_batch
from cspace.worlds.spatial.scene import SpatialScene, scenes_of, seen
from cspace.worlds.spatial.seeing.observed import lookup
from cspace.worlds.spatial.seeing.sight import FREE
from cspace.worlds.spatial.seen_checks import seen_checkers
from cspace.worlds.spatial.world import SpatialWorld, shipped
from cspace.worlds.unseen import Asked, Taken

PREFIX = "motionbench_"
# Of MotionBenchMaker's Panda, m.
FINGERS_M = 0.065


@dataclass(frozen=True, slots=True)
class SpatialPartlySeen:
    """See :class:`cspace.worlds.unseen.PartlySeen`."""

    world: SpatialWorld

    @property
    def sources(self) -> dict[str, tuple[str, ...]]:
        """MotionBenchMaker's sets, of the Panda alone, and the world's own families."""
        bench = {"MotionBenchMaker": tuple(PREFIX + family for family in BENCH_FAMILIES)}
        return (bench if is_benchmarked(self.world.body) else {}) | {"own families": FAMILIES}

    @property
    def hard(self) -> tuple[str, ...]:
        """Thin and tall shelves, the cage and the bin."""
        return tuple(PREFIX + family for family in ("bookshelf_thin", "bookshelf_tall", "cage", "box"))

    def count(self, family: str, split: Split) -> int | None:
        """Of MotionBenchMaker's sets."""
        return len(NUMBERS[split]) if family.startswith(PREFIX) else None

    def problem(self, asked: Asked, family: str, index: int, pictures: int) -> Problem | None:
        """See :func:`from_both_sides`; the arm waits at the start.

        That of MotionBenchMaker's problems has the wider limits of the benchmark.
        """
        world = with_benchmark_limits(self.world) if family.startswith(PREFIX) else self.world
        layout, start, goal, number = _found(world, asked, family, index)
        ends = np.array([start, goal])
        if not CollisionChecker(world.body, layout.obstacles).valid_batch(ends).all():
            return None
        rng = np.random.default_rng([25, pictures, *family.removeprefix(PREFIX).encode(), *number])
        scene = from_both_sides(rng, viewed(world, pictures), layout, ends[0], asked.aim)
        try:
            world.examined(scene.view())
        except ImageError:
            return None
        return Problem(scene, ends[0], ends[1], family, seed=asked.seed)

    def checkers(self, problem: Problem, image: Image, taken: Taken) -> Sequence[CollisionChecker]:
        """Where unseen space is occupied, room is made for the arm at the start, where it stands."""
        scene = cast("SpatialScene", problem.scenario)
        world, obstacles = scene.world, scene.obstacles
        if taken is Taken.KNOWN:
            return [CollisionChecker(world.body, obstacles)]
        ends = np.array([problem.start, problem.goal])
        if taken is Taken.TRUE:
            return seen_checkers(world, image, ends, obstacles)
        if taken is Taken.FREE:
            return seen_checkers(world, image, ends)
        occupied = image.copy()
        occupied[image[..., 1] != FREE, 0] = 0
        return seen_checkers(world, occupied, ends if taken is Taken.CLEARED else ends[:1])

    def unseen(self, image: Image, configurations: ArrayLike) -> NDArray[np.float64]:
        """By the centres of the spheres that move."""
        arrays = arm_arrays(self.world.body)
        rows = np.ascontiguousarray(configurations, dtype=np.float64)
        centres = sphere_centres_batch(rows, arrays)[:, arrays.links > 0]
        return np.asarray(lookup(image, self.world.sensor.grid, centres).unseen.mean(axis=1))

    def judge(self, problem: Problem) -> MeshJudge | None:
        """By convex hulls of the Panda's meshes; None for other arms as well."""
        scene = cast("SpatialScene", problem.scenario)
        meshes = _meshes(scene.world.body)
        return None if meshes is None else meshes.among(scene.obstacles)


def open_partly_seen(world: World) -> SpatialPartlySeen:
    """Of a world of this kind."""
    return SpatialPartlySeen(cast("SpatialWorld", world))


def is_benchmarked(arm: SerialArm) -> bool:
    """Whether it is MotionBenchMaker's Panda, whatever it is called and whichever limits its joints have."""
    if arm.dim != len(LIMITS_RAD):
        return False
    mine, panda = (replace(one, name="", ready_rad=None) for one in (arm, shipped("panda")))
    return mine.with_limits(LIMITS_RAD) == panda.with_limits(LIMITS_RAD)


def with_benchmark_limits(world: SpatialWorld) -> SpatialWorld:
    """The Panda's world with the limits of MotionBenchMaker's problems."""
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
    rng: np.random.Generator, world: SpatialWorld, layout: Layout, state: NDArray[np.float64], aim: str
) -> SpatialScene:
    """A layout as cameras see it that do not all stand on the same side of the line to what they look at.

    Args:
        rng: of all draws.
        world: with as many cameras as there are to be.
        layout: the scene, which cameras look at as it says.
        state: (d,) rad, of the arm.
        aim: ``scene`` has them look at the middle of all obstacles instead.

    Raises:
        ScenarioError: no camera has room.
    """
    if aim == "scene":
        layout = replace(layout, focus=middle(layout.obstacles))
    focus = np.asarray(layout.focus)[:2]
    while True:
        scene = seen(rng, world, layout, state)
        places = [np.array(camera.pose)[:2, 3] - focus for camera in scene.cameras]
        sides = {float(np.sign(x * focus[1] - y * focus[0])) for x, y in places}
        if len(places) == 1 or len(sides) > 1:
            return scene


def middle(obstacles: Obstacles) -> tuple[float, float, float]:
    """Of the box round all that stands there, m."""
    shapes: tuple[Box | Cylinder, ...] = (*obstacles.boxes, *obstacles.cylinders)
    solid = [
        (np.array(one.pose), np.array(one.half_m))
        if isinstance(one, Box)
        else (np.array(one.pose), np.array([one.radius_m, one.radius_m, one.half_length_m]))
        for one in shapes
    ]
    reach = [(pose[:3, 3], np.abs(pose[:3, :3]) @ half) for pose, half in solid]
    low = np.min([centre - half for centre, half in reach], axis=0)
    high = np.max([centre + half for centre, half in reach], axis=0)
    x, y, z = ((low + high) / 2.0).tolist()
    return x, y, z


_Found = tuple[Layout, tuple[float, ...], tuple[float, ...], tuple[int, ...]]


@lru_cache(maxsize=4)
def _found(world: SpatialWorld, asked: Asked, family: str, index: int) -> _Found:
    """Scene, start, goal and what pictures of the problem are seeded with."""
    if family.startswith(PREFIX):
        one = _bench(asked.split, asked.folder, family.removeprefix(PREFIX))[index]
        return one.layout(world.body), one.start, one.goal, (one.number,)
    drawn = draw_problem(world.body, scenes_of(world), asked.split, asked.seed, index, family)
    start, goal = (tuple(float(angle) for angle in end) for end in (drawn.start, drawn.goal))
    return drawn.layout, start, goal, (*asked.split.encode(), asked.seed, index)


@lru_cache(maxsize=16)
def _bench(split: Split, folder: Path | None, family: str) -> tuple[BenchProblem, ...]:
    return problems(split, folder, (family,))


@lru_cache(maxsize=2)
def _meshes(arm: SerialArm) -> RobotMeshes | None:
    urdf = panda_urdf()
    if urdf is None or not is_benchmarked(arm):
        return None
    held = dict.fromkeys(("panda_finger_joint1", "panda_finger_joint2"), FINGERS_M)
    try:
        return RobotMeshes(arm, Description(urdf, held))
    except ScenarioError:
        return None
