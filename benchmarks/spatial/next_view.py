"""What a second depth picture is worth where POST /plan says to look next, beside one from anywhere.

    python -m benchmarks.spatial.next_view BUNDLE [--aim scene] [--each 10]

Problems and first pictures are those of `python -m services.evaluator planning --protocol plans`. The second
camera is the one that the first plan names, of a hemisphere about its most uncertain place, or one of the
same hemisphere by chance. Both pictures are noisy, the arm is in them; the plan from both is checked as in
that protocol. Printed are the share of the paths that collide, with 95 % bootstrap intervals over the
problems that all three solve, and the median of their cost, -log of the confidence.
"""

import sys
from dataclasses import replace

import numpy as np

from benchmarks.machine import machine
from benchmarks.spatial.problem_options import (
    LIMIT_S,
    LOOK_RAD,
    PATHS,
    benchmark_bundle,
    chosen_problems,
    panda_world,
    problem_arguments,
)
from cspace.bundle import Bundle
from cspace.planning.paths import spaced
from cspace.query import Plan, PlanQuery
from cspace.worlds.spatial.benchmark import BenchProblem, from_both_sides, viewed
from cspace.worlds.spatial.camera import DepthCamera, read_camera
from cspace.worlds.spatial.checks import CollisionChecker
from cspace.worlds.spatial.next_view import away_m, hemisphere
from cspace.worlds.spatial.scenes import SpatialScene
from cspace.worlds.spatial.world import SpatialWorld
from services.evaluator.statistics import difference_interval, mean_interval

ARMS = ("first picture", "and where to look next", "and anywhere")


def evaluate(
    bundle: Bundle, world: SpatialWorld, problem: BenchProblem, aim: str
) -> list[tuple[float, float]] | None:
    """Cost and clearance of each arm's path; None where one solves nothing or the ends collide."""
    truth = CollisionChecker(world.body, problem.obstacles)
    ends = np.array([problem.start, problem.goal])
    if not truth.valid_batch(ends).all():
        return None
    rng = np.random.default_rng([25, 1, *problem.family.encode(), problem.number])
    first = from_both_sides(rng, world, problem.layout(world.body), ends[0], aim)
    cameras = tuple(one.to_dict() for one in first.cameras)
    query = PlanQuery(tuple(ends[0]), tuple(ends[1]), 0, 0.0, LIMIT_S, PATHS, next_view=True, seen_by=cameras)
    found = planned(bundle, world, first, query)
    if found.next_view is None:
        return None
    named = read_camera(found.next_view.camera)
    learned = panda_world(bundle)
    around = hemisphere(learned, named.matrix[:3, 3] + away_m(learned) * named.matrix[:3, 2])
    other = around[int(rng.integers(len(around)))]
    plans = [found, *(planned(bundle, world, seen_too(first, camera), query) for camera in (named, other))]
    if any(not len(one.path) for one in plans):
        return None
    clearances = [truth.clearance(spaced(one.path, world.space, LOOK_RAD)).min() for one in plans]
    costs = [-np.log(max(one.confidence, 1e-9)) for one in plans]
    return [(float(cost), float(one)) for cost, one in zip(costs, clearances, strict=True)]


def planned(bundle: Bundle, world: SpatialWorld, scene: SpatialScene, query: PlanQuery) -> Plan:
    """By what the scene's cameras see."""
    return bundle.plan(bundle.prepare(world.examined(scene.view())), query)


def seen_too(scene: SpatialScene, camera: DepthCamera) -> SpatialScene:
    """The scene with a further camera."""
    return replace(scene, cameras=(*scene.cameras, camera))


def main() -> int:
    parser = problem_arguments(__doc__)
    options = parser.parse_args()
    bundle = benchmark_bundle(options.bundle)
    world = viewed(panda_world(bundle), 1)
    rows = [evaluate(bundle, world, problem, options.aim) for problem in chosen_problems(options)]
    solved = np.array([row for row in rows if row is not None])
    rng = np.random.default_rng(0)
    print(machine())
    print(f"{len(solved)} of {len(rows)} problems solved from all, {options.split}; collide, median cost")
    for number, arm in enumerate(ARMS):
        hits = [float(one) for one in solved[:, number, 1] <= 0.0]
        print(f"{arm:<24}{mean_interval(hits, rng):.3f}, {np.median(solved[:, number, 0]):.3f}")
    fewer = difference_interval(solved[:, 2, 1] <= 0.0, solved[:, 1, 1] <= 0.0, rng)
    lower_cost = difference_interval(solved[:, 2, 0], solved[:, 1, 0], rng)
    print(f"less where one looks next than anywhere: collide {fewer:.3f}, cost {lower_cost:.3f}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
