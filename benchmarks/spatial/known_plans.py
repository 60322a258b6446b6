"""What plans from one depth picture gain where a planner knows the table, the furniture, or everything.

    python -m benchmarks.spatial.known_plans BUNDLE [--aim scene] [--each 10]

Problems and pictures are those of `python -m services.evaluator planning --protocol plans`. Each is planned
five times by the same model: with nothing known, with the scene's box of the largest level face known, with
all boxes known that have a face of 0.3 m x 0.3 m or more, with all obstacles known, and with these and
all else to be ignored. Printed are the shares that are solved, and of the paths the share that collides by
the spheres and by the meshes, either with the difference from nothing known where both found a path, with
95 % bootstrap intervals, and the median time of the search; beside them RRT-Connect by the same checks of all
obstacles. One process, about 10 s a problem.
"""

import sys
import time
from collections.abc import Sequence
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
from cspace.planning.search import find_paths
from cspace.query import PlanQuery
from cspace.worlds.spatial.benchmark import (
    FINGERS_M,
    BenchProblem,
    body_of,
    from_both_sides,
    level_face,
    viewed,
)
from cspace.worlds.spatial.checks import CollisionChecker
from cspace.worlds.spatial.mesh_checker import Description, RobotMeshes, panda_urdf
from cspace.worlds.spatial.obstacles import Box, Cylinder
from cspace.worlds.spatial.planning_scene import Body, BoxShape, PlanningScene
from cspace.worlds.spatial.world import SpatialWorld
from services.evaluator.statistics import difference_interval, mean_interval

ARMS = ("nothing", "table", "table and walls", "all", "all, else free")
WALL_M = 0.3
EVERYWHERE = Body(box=BoxShape((4.0, 4.0, 4.0)))


def known_of(problem: BenchProblem, arm: str) -> PlanningScene:
    """What is known in an arm of the comparison."""
    boxes = problem.obstacles.boxes
    shapes: Sequence[Box | Cylinder] = ()
    if arm == "table":
        shapes = sorted(boxes, key=level_face)[-1:]
    elif arm == "table and walls":
        shapes = [one for one in boxes if 2.0 * sorted(one.half_m)[1] >= WALL_M]
    elif arm != "nothing":
        shapes = (*boxes, *problem.obstacles.cylinders)
    scene = tuple(body_of(str(at), one) for at, one in enumerate(shapes))
    return PlanningScene(scene, ignore=(EVERYWHERE,) if arm == "all, else free" else ())


def planned(
    bundle: Bundle, world: SpatialWorld, meshes: RobotMeshes | None, problem: BenchProblem, aim: str
) -> list[tuple[float, float, float, float]] | None:
    """Solved, collides by spheres, by meshes, and seconds, of each arm and of RRT-Connect."""
    truth = CollisionChecker(world.body, problem.obstacles)
    ends = np.array([problem.start, problem.goal])
    if not truth.valid_batch(ends).all():
        return None
    by_meshes = None if meshes is None else meshes.among(problem.obstacles)
    rng = np.random.default_rng([25, 1, *problem.family.encode(), problem.number])
    view = from_both_sides(rng, world, problem.layout(world.body), ends[0], aim).view()
    query = PlanQuery(tuple(ends[0]), tuple(ends[1]), 0, 0.0, LIMIT_S, PATHS)
    found = []
    for arm in ARMS:
        examined = world.examined(replace(view, known=known_of(problem, arm)))
        picture = replace(bundle.prepare(examined.images[0]), known=examined.known)
        began = time.perf_counter()
        plan = bundle.plan(picture, query)
        spent_s = time.perf_counter() - began
        if not len(plan.path):
            found.append((0.0, np.nan, np.nan, spent_s))
            continue
        states = spaced(plan.path, world.space, LOOK_RAD)
        hits = np.nan if by_meshes is None else float(not by_meshes.valid_batch(states).all())
        found.append((1.0, float(truth.clearance(states).min() <= 0.0), hits, spent_s))
    began = time.perf_counter()
    paths = find_paths([truth], *ends, PATHS, 0, time.thread_time() + LIMIT_S).paths
    found.append((float(bool(paths)), 0.0, 0.0, time.perf_counter() - began))
    return found


def main() -> int:
    """Prints the figures; returns the exit code."""
    options = problem_arguments(__doc__).parse_args()
    bundle = benchmark_bundle(options.bundle)
    world, urdf = viewed(panda_world(bundle), 1), panda_urdf()
    held = dict.fromkeys(("panda_finger_joint1", "panda_finger_joint2"), FINGERS_M)
    meshes = None if urdf is None else RobotMeshes(world.body, Description(urdf, held))
    rows = [planned(bundle, world, meshes, problem, options.aim) for problem in chosen_problems(options)]
    found = np.array([row for row in rows if row is not None])
    rng = np.random.default_rng(0)
    print(machine())
    print(f"{len(found)} problems, {options.split}; solved, collide by spheres and by meshes, median seconds")
    has_path = found[:, :, 0] > 0.0
    for number, arm in enumerate((*ARMS, "RRT-Connect")):
        own, both = has_path[:, number], has_path[:, 0] & has_path[:, number]
        shares = [
            f"{mean_interval(found[own, number, by], rng)}, "
            f"{difference_interval(found[both, number, by], found[both, 0, by], rng):+.3f}"
            for by in ((1,) if meshes is None else (1, 2))
        ]
        print(f"{arm:<16}{own.mean():.3f}  {'  '.join(shares)}  {np.median(found[:, number, 3]):.3f} s")
    return 0


if __name__ == "__main__":
    sys.exit(main())
