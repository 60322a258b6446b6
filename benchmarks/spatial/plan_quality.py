"""How often plans of POST /plan collide in truth, beside what planners do with unseen space.

    python -m benchmarks.spatial.plan_quality BUNDLE [--cameras 2] [--aim scene] [--each 10]

Problems of MotionBenchMaker, seen with noise by cameras 30 to 60 degrees off the line from what they look at
to the robot, 20 to 40 degrees up, 1.1 to 1.3 m away, with 70 degrees of view; of two cameras one stands on
either side. They look at the goal's hand, or with --aim scene at the middle of the box round all obstacles.
The arm is in the picture. Test problems are for figures that are reported, once. One process, minutes.

All arms search alike (eight ways, the same draws); they differ in what they take the scene to be, and in the
way that they choose:

    least doubtful     what is seen; the way that the model doubts least, as POST /plan
    unseen is free     what is seen; the shortest way
    unseen is occupied what is seen free; the shortest way; room is made at start and goal
    truth              the scene itself; the shortest way

A way collides where its clearance, looked at every 0.01 rad by the arm's spheres, is not above 0; deeply
where it is below -1 cm. Shares of what is solved, with 95 % bootstrap intervals over problems. Times are of
search and scoring, without the picture's.
"""

import sys
import time
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from benchmarks.machine import machine
from benchmarks.spatial.problem_options import chosen_problems, problem_arguments
from benchmarks.spatial.spheres_and_meshes import panda
from cspace.bundle import Bundle
from cspace.connecting import length_rad, spaced
from cspace.planning.query import PlanQuery
from cspace.planning.ways import find_ways
from cspace.worlds import seen_checkers
from cspace.worlds.spatial.motionbench.problems import FAMILIES, BenchProblem
from cspace.worlds.spatial.obstacles.shapes import Box, Obstacles
from cspace.worlds.spatial.planning.collision import CollisionChecker
from cspace.worlds.spatial.scene import SpatialScene, seen
from cspace.worlds.spatial.seeing.sight import FREE
from cspace.worlds.spatial.world import SpatialWorld
from services.evaluator.statistics import mean_interval
from training.clusters.plan_doubt import calibration_error

ARMS = ("least doubtful", "unseen is free", "unseen is occupied", "truth")
DEEP_M, LOOK_RAD, WAYS, LIMIT_S = 0.01, 0.01, 8, 2.0
SHARES = (1.0, 0.8, 0.6, 0.4, 0.2)


@dataclass(frozen=True)
class Judged:
    """One arm's answer to one problem."""

    arm: str
    family: str
    solved: bool
    clearance_m: float
    confidence: float
    ms: float

    def hits(self, deep_m: float = 0.0) -> bool:
        """Whether the way collides so deeply."""
        return self.clearance_m <= -deep_m


def viewed(world: SpatialWorld, cameras: int) -> SpatialWorld:
    """The world as the benchmark sees it."""
    views = replace(
        world.sensor.views,
        count=(cameras, cameras),
        side_deg=(30.0, 60.0),
        up_deg=(20.0, 40.0),
        distance_m=(1.1, 1.3),
        field_deg=(70.0, 70.0),
    )
    return replace(world, sensor=replace(world.sensor, views=views, holes=0.0))


def from_both_sides(
    rng: np.random.Generator, world: SpatialWorld, problem: BenchProblem, aim: str
) -> SpatialScene:
    """The problem's scene, of several cameras not all on the same side."""
    layout = problem.layout(world.body)
    if aim == "scene":
        layout = replace(layout, focus=middle(problem.obstacles))
    focus = np.asarray(layout.focus)[:2]
    while True:
        scene = seen(rng, world, layout, np.array(problem.start))
        places = [np.array(camera.pose)[:2, 3] - focus for camera in scene.cameras]
        sides = {float(np.sign(x * focus[1] - y * focus[0])) for x, y in places}
        if len(places) == 1 or len(sides) > 1:
            return scene


def middle(obstacles: Obstacles) -> tuple[float, float, float]:
    """Of the box round all that stands there, m: what cameras look at."""
    solid = [
        (np.array(one.pose), np.array(one.half_m))
        if isinstance(one, Box)
        else (np.array(one.pose), np.array([one.radius_m, one.radius_m, one.half_length_m]))
        for one in (*obstacles.boxes, *obstacles.cylinders)
    ]
    reach = [(pose[:3, 3], np.abs(pose[:3, :3]) @ half) for pose, half in solid]
    low = np.min([centre - half for centre, half in reach], axis=0)
    high = np.max([centre + half for centre, half in reach], axis=0)
    x, y, z = ((low + high) / 2.0).tolist()
    return x, y, z


def judged(
    bundle: Bundle, world: SpatialWorld, problem: BenchProblem, cameras: int, aim: str
) -> list[Judged]:
    """All arms on one problem; none where start or goal collides in truth."""
    truth = CollisionChecker(world.body, problem.obstacles)
    ends = np.array([problem.start, problem.goal])
    if not truth.valid_batch(ends).all():
        return []
    rng = np.random.default_rng([25, cameras, *problem.family.encode(), problem.number])
    scene = from_both_sides(rng, world, problem, aim)
    picture = world.observed(scene.view())
    occupied = picture.copy()
    occupied[picture[..., 1] != FREE, 0] = 0
    prepared = bundle.prepare(picture)
    query = PlanQuery(tuple(ends[0]), tuple(ends[1]), 0, 0.0, LIMIT_S, WAYS)
    began = time.perf_counter()
    planned = bundle.plan(prepared, query)
    found = [(planned.way if len(planned.way) else None, planned.confidence, time.perf_counter() - began)]
    checks = (
        lambda: seen_checkers(world, picture, ends),
        lambda: seen_checkers(world, occupied, ends),
        lambda: [truth],
    )
    for make in checks:
        began = time.perf_counter()
        ways, _ = find_ways(make(), ends[0], ends[1], WAYS, 0, time.monotonic() + LIMIT_S)
        shortest = min(ways, key=lambda way: length_rad(way, world.space), default=None)
        found.append((shortest, 1.0, time.perf_counter() - began))
    rows = []
    for arm, (way, confidence, spent_s) in zip(ARMS, found, strict=True):
        clearance = np.nan
        if way is not None:
            clearance = float(truth.clearance(spaced(way, world.space, LOOK_RAD)).min())
        rows.append(Judged(arm, problem.family, way is not None, clearance, confidence, 1e3 * spent_s))
    return rows


def report(rows: Sequence[Judged], rng: np.random.Generator) -> list[str]:
    """Lines: each arm, the least doubtful by family, by confidence."""
    lines = [f"{'':<20}solved, collide, deeply; ms median, p95"]
    for arm in ARMS:
        own = [row for row in rows if row.arm == arm]
        solved = [row for row in own if row.solved]
        hits = "none" if not solved else f"{mean_interval([float(row.hits()) for row in solved], rng):.3f}"
        deep = "none" if not solved else f"{np.mean([row.hits(DEEP_M) for row in solved]):.3f}"
        spent = [row.ms for row in own]
        times = f"{np.median(spent):.0f}, {np.quantile(spent, 0.95):.0f}"
        lines.append(f"{arm:<20}{len(solved) / len(own):.3f}, {hits}, {deep}; {times}")
    lines.append("share that collides by family: " + ", ".join(ARMS))
    for family in FAMILIES:
        shares = []
        for arm in ARMS:
            own = [row.hits() for row in rows if row.solved and (row.arm, row.family) == (arm, family)]
            shares.append(f"{np.mean(own):.2f} of {len(own)}" if own else "none")
        lines.append(f"  {family:<20}" + ", ".join(shares))
    return [*lines, *by_confidence([row for row in rows if row.arm == ARMS[0] and row.solved])]


def by_confidence(rows: Sequence[Judged]) -> list[str]:
    """What collides among the surest shares, and how far confidence and truth are apart."""
    sure = np.array([row.confidence for row in rows])
    free = np.array([row.clearance_m > 0.0 for row in rows])
    order = np.argsort(-sure)
    lines = ["the surest share of the plans: least confidence, collide"]
    for share in SHARES:
        chosen = order[: max(1, int(share * len(order)))]
        lines.append(f"  {share:.1f}  {sure[chosen].min():.3f}  {1.0 - free[chosen].mean():.3f}")
    return [*lines, f"calibration error of the confidence, ten bins: {calibration_error(sure, free):.3f}"]


def main() -> int:
    parser = problem_arguments(__doc__)
    parser.add_argument("--cameras", type=int, default=1)
    options = parser.parse_args()
    bundle = Bundle.load(options.bundle)
    world = viewed(panda_world(bundle), options.cameras)
    chosen = chosen_problems(options)
    rows = [row for problem in chosen for row in judged(bundle, world, problem, options.cameras, options.aim)]
    print(machine())
    print(f"{len(rows) // len(ARMS)} of {len(chosen)} {options.split} problems, {options.cameras} cameras")
    print("\n".join(report(rows, np.random.default_rng(0))))
    return 0


def panda_world(bundle: Bundle) -> SpatialWorld:
    """The bundle's world, whose robot is the Panda."""
    world = bundle.spec.world
    if not isinstance(world, SpatialWorld) or world.body != panda():
        raise SystemExit("the problems are those of the Panda: name a bundle of its world")
    return world


if __name__ == "__main__":
    sys.exit(main())
