"""Which problems of MotionBenchMaker a benchmark takes, on its command line."""

from argparse import ArgumentParser, Namespace
from pathlib import Path

from benchmarks.command import arguments
from cspace.splits import Split
from cspace.worlds.spatial.motionbench.problems import FAMILIES, BenchProblem, problems


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
    for family in FAMILIES:
        of_family = problems(Split(options.split), options.problems, families=(family,))
        chosen += of_family[: options.each or None]
    return chosen
