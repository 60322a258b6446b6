"""What confidence and novelty say where a scene is seen as no training saw it, or holds what none held.

    python -m benchmarks.spatial.misuse BUNDLE [--each 10]

Problems of MotionBenchMaker as `python -m services.evaluator planning --protocol plans` has them, one picture
each, changed in one way at a time: noise, where the camera stands and how wide it looks, what is missing,
where the camera is said to stand, whether the arm's state is told, and things that no family of scenes has
(rods of 4 to 8 mm, boxes at any tilt). For each: share of the plans that collide, with its 95 %
bootstrap interval, their mean confidence, the difference of it to the share that is free, the median novelty,
and the share of pictures with a novelty above 0.95.
"""

import sys
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from benchmarks.command import arguments
from benchmarks.machine import machine
from benchmarks.spatial.problem_options import LIMIT_S, LOOK_RAD, PATHS, benchmark_bundle, panda_world
from cspace.bundle import Bundle
from cspace.planning.paths import spaced
from cspace.query import PlanQuery
from cspace.simulator import Split
from cspace.worlds.spatial.benchmark import BENCH_FAMILIES, BenchProblem, from_both_sides, problems, viewed
from cspace.worlds.spatial.checks import CollisionChecker
from cspace.worlds.spatial.obstacles import Box, Cylinder, Obstacles
from cspace.worlds.spatial.poses import make_pose, pose_of
from cspace.worlds.spatial.scenes import SpatialScene
from cspace.worlds.spatial.view import DepthView
from cspace.worlds.spatial.world import SpatialWorld
from services.evaluator.statistics import mean_interval

NEW = 0.95
Change = Callable[[DepthView, np.random.Generator], DepthView]


@dataclass(frozen=True)
class Misuse:
    """One way in which things are not as they were in training.

    Args:
        views: of the cameras' distribution, what differs.
        noise: of the pictures, instead of the drawn one; ``exact`` for none.
        change: of what is told.
        shapes: what is added to the obstacles.
    """

    views: Mapping[str, object] | None = None
    noise: str | None = None
    change: Change | None = None
    shapes: Callable[[np.random.Generator], Obstacles] | None = None


def half_missing(view: DepthView, rng: np.random.Generator) -> DepthView:
    """One half of each picture read nothing."""
    kept = []
    for picture in view.pictures:
        found, half = picture.copy(), picture.shape[1] // 2
        if rng.random() < 0.5:
            found[:, :half] = 0
        else:
            found[:, half:] = 0
        kept.append(found if found.any() else picture)
    return replace(view, pictures=tuple(kept))


def moved(by_m: float) -> Change:
    """The camera is said to stand so far from where it is, in any direction."""

    def change(view: DepthView, rng: np.random.Generator) -> DepthView:
        cameras = []
        for camera in view.cameras:
            pose, path = camera.matrix, rng.normal(size=3)
            pose[:3, 3] += by_m * path / np.linalg.norm(path)
            cameras.append(replace(camera, pose=pose_of(pose)))
        return replace(view, cameras=tuple(cameras))

    return change


def stateless(view: DepthView, rng: np.random.Generator) -> DepthView:
    """Nobody says that the arm is in the picture."""
    del rng
    return replace(view, state=None)


def _placed(rng: np.random.Generator) -> tuple[tuple[float, ...], ...]:
    """Any rotation, somewhere the arm reaches."""
    axes, _ = np.linalg.qr(rng.normal(size=(3, 3)))
    axes[:, 0] *= np.sign(np.linalg.det(axes))
    bearing, away = rng.uniform(-2.0, 2.0), rng.uniform(0.35, 0.8)
    place = (away * np.cos(bearing), away * np.sin(bearing), rng.uniform(0.1, 0.9))
    return pose_of(make_pose(axes, place))


def rods(rng: np.random.Generator) -> Obstacles:
    """Eight thin rods."""
    sizes = [(rng.uniform(0.004, 0.008), rng.uniform(0.15, 0.4)) for _ in range(8)]
    return Obstacles.of(tuple(Cylinder(_placed(rng), float(r), float(h)) for r, h in sizes))


def tilted(rng: np.random.Generator) -> Obstacles:
    """Five boxes at any tilt."""
    halves = [tuple(float(one) for one in rng.uniform(0.03, 0.1, 3)) for _ in range(5)]
    return Obstacles.of(tuple(Box(_placed(rng), half) for half in halves))


MISUSES = {
    "as in training": Misuse(),
    "exact pictures": Misuse(noise="exact"),
    "disparity noise": Misuse(noise="disparity"),
    "from the far side": Misuse({"side_deg": (100.0, 150.0)}),
    "from high above": Misuse({"up_deg": (65.0, 80.0)}),
    "from 2 to 2.5 m": Misuse({"distance_m": (2.0, 2.5)}),
    "35 degrees wide": Misuse({"field_deg": (35.0, 35.0)}),
    "100 degrees wide": Misuse({"field_deg": (100.0, 100.0)}),
    "half of it missing": Misuse(change=half_missing),
    "camera off by 1 cm": Misuse(change=moved(0.01)),
    "camera off by 3 cm": Misuse(change=moved(0.03)),
    "no state": Misuse(change=stateless),
    "rods": Misuse(shapes=rods),
    "tilted boxes": Misuse(shapes=tilted),
}


@dataclass(frozen=True)
class Outcome:
    """A plan in a misused picture: whether it collides, how sure it was, how new the picture."""

    collides: bool
    confidence: float
    novelty: float


def evaluate(bundle: Bundle, world: SpatialWorld, problem: BenchProblem, misuse: Misuse) -> Outcome | None:
    """None where the ends collide or no way was found."""
    rng = np.random.default_rng([27, *problem.family.encode(), problem.number])
    ends = np.array([problem.start, problem.goal])
    obstacles = problem.obstacles
    if misuse.shapes is not None:
        more = misuse.shapes(rng)
        obstacles = Obstacles((*obstacles.boxes, *more.boxes), (*obstacles.cylinders, *more.cylinders))
    truth = CollisionChecker(world.body, obstacles)
    if not truth.valid_batch(ends).all():
        return None
    views = replace(world.sensor.views, **(misuse.views or {}))
    seen_by = replace(world, sensor=replace(world.sensor, views=views))
    layout = problem.layout(world.body)
    scene = replace(from_both_sides(rng, seen_by, layout, ends[0], "goal"), obstacles=obstacles)
    view = _noisy(scene, misuse).view()
    prepared = bundle.prepare(world.observed(view if misuse.change is None else misuse.change(view, rng)))
    query = PlanQuery(tuple(ends[0]), tuple(ends[1]), 0, 0.0, LIMIT_S, PATHS)
    found = bundle.plan(prepared, query)
    if not len(found.path):
        return None
    clearance = truth.clearance(spaced(found.path, world.space, LOOK_RAD)).min()
    return Outcome(bool(clearance <= 0.0), found.confidence, prepared.novelty or 0.0)


def _noisy(scene: SpatialScene, misuse: Misuse) -> SpatialScene:
    if misuse.noise is None:
        return scene
    return replace(scene, noise=None if misuse.noise == "exact" else misuse.noise)


def main() -> int:
    parser = arguments(__doc__)
    parser.add_argument("bundle", type=Path)
    parser.add_argument("--each", type=int, default=0, help="problems of each family; 0 for all")
    options = parser.parse_args()
    bundle = benchmark_bundle(options.bundle)
    world = viewed(panda_world(bundle), 1)
    print(machine())
    print(f"{'':<20}plans: collide; confidence, above what is free; novelty, share above {NEW:g}", flush=True)
    chosen = [
        one
        for family in BENCH_FAMILIES
        for one in problems(Split.VALIDATION, families=(family,))[: options.each or None]
    ]
    for name, misuse in MISUSES.items():
        rows = [row for row in (evaluate(bundle, world, one, misuse) for one in chosen) if row is not None]
        hits = np.array([row.collides for row in rows])
        confidence, new = (
            np.array([getattr(row, part) for row in rows]) for part in ("confidence", "novelty")
        )
        share = mean_interval(hits.astype(float), np.random.default_rng(0))
        gap = confidence.mean() - (1.0 - hits.mean())
        line = f"{len(rows)}: {share:.3f}; {confidence.mean():.3f}, {gap:+.3f}; {np.median(new):.2f}"
        print(f"{name:<20}{line}, {np.mean(new > NEW):.2f}", flush=True)
    return 0


if __name__ == "__main__":
    sys.exit(main())
