"""Which problems of MotionBenchMaker a benchmark takes, on its command line, and how it asks for plans."""

from argparse import ArgumentParser, Namespace
from pathlib import Path

from benchmarks.command import arguments
from cspace.bundle import Bundle
from cspace.query import DEFAULT_PATHS
from cspace.simulator import Split
from cspace.worlds.spatial.arm import SerialArm
from cspace.worlds.spatial.benchmark import (
    BENCH_FAMILIES,
    LIMITS_RAD,
    BenchProblem,
    is_benchmarked,
    problems,
    with_benchmark_limits,
)
from cspace.worlds.spatial.world import SpatialWorld, shipped

LOOK_RAD, PATHS, LIMIT_S = 0.01, DEFAULT_PATHS, 2.0


def panda() -> SerialArm:
    """The robot that ships, with the limits of the benchmark's problems."""
    return shipped("panda").with_limits(LIMITS_RAD)


def problem_arguments(description: str | None) -> ArgumentParser:
    """A parser of a bundle, the problems, and what the first camera looks at."""
    parser = arguments(description)
    parser.add_argument("bundle", type=Path)
    parser.add_argument("--split", choices=("validation", "test"), default="validation")
    parser.add_argument("--problems", type=Path, help="the folder of the test problems")
    parser.add_argument("--each", type=int, default=0, help="problems of each family; 0 for all")
    parser.add_argument("--aim", choices=("goal", "scene"), default="goal")
    return parser


def chosen_problems(options: Namespace) -> list[BenchProblem]:
    """Those that the options name, family after family."""
    chosen: list[BenchProblem] = []
    for family in BENCH_FAMILIES:
        of_family = problems(Split(options.split), options.problems, families=(family,))
        chosen += of_family[: options.each or None]
    return chosen


def panda_world(bundle: Bundle) -> SpatialWorld:
    """The bundle's world, whose robot is the Panda, with the limits of the benchmark."""
    world = bundle.spec.world
    if not isinstance(world, SpatialWorld) or not is_benchmarked(world.body):
        raise SystemExit("the problems are those of the Panda: name a bundle of its world")
    return with_benchmark_limits(world)


def benchmark_bundle(folder: Path) -> Bundle:
    """The bundle of a folder with the limits of the benchmark."""
    bundle = Bundle.load(folder)
    return bundle.within(panda_world(bundle))
