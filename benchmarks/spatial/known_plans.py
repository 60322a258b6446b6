"""What plans from one depth picture gain where a planner knows the table, or everything.

    python -m benchmarks.spatial.known_plans BUNDLE [--aim scene] [--each 10]

Problems and pictures are those of `python -m services.evaluator planning --protocol plans`. Each is planned
three times by the same model: with nothing known, with the scene's box of the largest level face known, and
with all obstacles known. Printed are the shares that are solved, and of the paths the share that collides by
the spheres and by the meshes, with 95 % bootstrap intervals, and the median time of the search; beside them
the time of RRT-Connect by the same checks of all obstacles. One process, minutes.
"""

import json
import sys
import time
from dataclasses import replace
from typing import Any

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
from cspace.worlds.spatial.benchmark import FINGERS_M, BenchProblem, from_both_sides, viewed
from cspace.worlds.spatial.checks import CollisionChecker
from cspace.worlds.spatial.mesh_checker import Description, RobotMeshes, panda_urdf
from cspace.worlds.spatial.obstacles import Box, Obstacles
from cspace.worlds.spatial.planning_scene import read_planning_scene
from cspace.worlds.spatial.world import SpatialWorld
from services.evaluator.statistics import mean_interval

ARMS = ("nothing", "table", "all")


def bodies(obstacles: Obstacles) -> list[dict[str, Any]]:
    """The fields of a request."""
    boxes = [
        {"box": {"size_m": [2.0 * half for half in one.half_m]}, "pose": one.pose} for one in obstacles.boxes
    ]
    cylinders = [
        {"cylinder": {"radius_m": one.radius_m, "length_m": 2.0 * one.half_length_m}, "pose": one.pose}
        for one in obstacles.cylinders
    ]
    return [{"name": str(at), **one} for at, one in enumerate(boxes + cylinders)]


def level_face(box: Box) -> float:
    """Area of the face that looks up the most, square metres."""
    up = int(np.argmax(np.abs(np.asarray(box.pose)[2, :3])))
    return float(4.0 * np.prod(np.delete(box.half_m, up)))


def known_of(problem: BenchProblem, arm: str) -> list[dict[str, Any]]:
    """What is known in an arm of the comparison."""
    if arm == "all":
        return bodies(problem.obstacles)
    boxes = sorted(problem.obstacles.boxes, key=level_face)[-1:] if arm == "table" else []
    return bodies(Obstacles.of(boxes))


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
        text = json.dumps({"scene": known_of(problem, arm)}).encode()
        examined = world.examined(replace(view, known=read_planning_scene(text)))
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
    print(f"{len(found)} problems, {options.split}; solved, collide (spheres, meshes), median seconds")
    for number, arm in enumerate((*ARMS, "RRT-Connect")):
        solved, spheres, hits, spent_s = found[:, number].T
        shares = [mean_interval([float(one) for one in part[solved > 0.0]], rng) for part in (spheres, hits)]
        print(f"{arm:<12}{solved.mean():.3f}  {shares[0]:.3f}  {shares[1]:.3f}  {np.median(spent_s):.3f} s")
    return 0


if __name__ == "__main__":
    sys.exit(main())
