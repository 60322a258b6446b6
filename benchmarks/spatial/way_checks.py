"""How many exact checks a planner needs with the ways of POST /plan, beside none.

    python -m benchmarks.spatial.way_checks BUNDLE [--cameras 2] [--aim scene] [--each 10] [--seeds 3]

Problems and pictures are those of plan_quality. Checks are the arm's spheres against the true obstacles,
each 0.02 rad of the joint that moves most. With ways: all that POST /plan finds are checked as they are, the
surest first and its least sure piece first; where none is free, RRT-Connect draws configurations about them.
Without: the same RRT-Connect with uniform configurations. States that are looked at until the first path, the
median over seeds; of these median and 90th percentile over problems, with ratios' 95 % bootstrap intervals. A
problem that is not solved counts as the most of all.
"""

import sys
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np
from numpy.typing import NDArray

from benchmarks.machine import machine
from benchmarks.spatial.plan_quality import LIMIT_S, WAYS, from_both_sides, panda_world, viewed
from benchmarks.spatial.problem_options import chosen_problems, problem_arguments
from cspace.bundle import Bundle
from cspace.planning.query import PlanQuery
from cspace.problem import Problem
from cspace.worlds import checker_of, workshop_of
from cspace.worlds.spatial.motionbench.problems import FAMILIES, BenchProblem
from cspace.worlds.spatial.world import SpatialWorld
from services.evaluator.statistics import bootstrap_interval
from services.planner.search.ompl_planner import solve
from services.planner.search.ways_first import solve_with_ways
from services.planner.settings import SAMPLED_CONNECT, PlannerSettings

HARD = ("bookshelf_thin", "bookshelf_tall", "cage", "box")
TIME_S, ITERATIONS, NEVER = 20.0, 200_000, 1e8


@dataclass(frozen=True)
class Counted:
    """One problem: states looked at, :data:`NEVER` where it was not solved.

    Args:
        family: of the problem.
        with_ways: states.
        uniform: states, the median over seeds.
        as_is: whether one of the ways was free as it was.
    """

    family: str
    with_ways: float
    uniform: float
    as_is: bool


def counted(
    bundle: Bundle, world: SpatialWorld, problem: BenchProblem, cameras: int, aim: str, seeds: int
) -> Counted | None:
    """A problem both ways; None where start or goal collides in truth."""
    rng = np.random.default_rng([25, cameras, *problem.family.encode(), problem.number])
    scene = from_both_sides(rng, world, problem, aim)
    asked = Problem(scene, np.array(problem.start), np.array(problem.goal), problem.family)
    ends = np.stack([asked.start, asked.goal])
    if not checker_of(scene).valid_batch(ends).all():
        return None
    query = PlanQuery(tuple(ends[0]), tuple(ends[1]), 0, 0.0, LIMIT_S, WAYS, alternatives=True)
    found = bundle.plan(bundle.prepare(world.observed(scene.view())), query)
    measures = workshop_of(world).measures
    runs = []
    for seed in range(seeds):
        settings = PlannerSettings(
            planner=SAMPLED_CONNECT,
            range_rad=measures.range_rad,
            resolution_rad=measures.resolution_rad,
            time_limit_s=TIME_S,
            max_iterations=ITERATIONS,
            seed=seed,
        )
        own, plain = solve_with_ways(asked, settings, found.alternatives), solve(asked, settings)
        runs.append([one.state_checks if one.solved else NEVER for one in (own, plain)])
        as_is = own.solved and own.iterations == 0
    with_ways, uniform = np.median(runs, axis=0)
    return Counted(problem.family, float(with_ways), float(uniform), as_is)


def lines(rows: Sequence[Counted], rng: np.random.Generator) -> list[str]:
    """By family, and the hard ones together."""
    told = ["family, problems: states with ways and without, median (p90); ratios; free as they are, share"]
    groups = {family: [row for row in rows if row.family == family] for family in FAMILIES}
    groups["thin, tall, cage, box"] = [row for row in rows if row.family in HARD]
    for name, own in groups.items():
        if not own:
            continue
        pairs = np.array([[row.with_ways, row.uniform] for row in own])
        middle, high = (np.quantile(pairs, share, axis=0, method="higher") for share in (0.5, 0.9))
        ratios = [f"{bootstrap_interval(pairs, partial(_ratio, share), rng):.2f}" for share in (0.5, 0.9)]
        shares = f"{np.mean([row.as_is for row in own]):.2f}"
        states = ", ".join(f"{one:.0f} ({most:.0f})" for one, most in zip(middle, high, strict=True))
        told.append(f"  {name:<24}{len(own)}: {states}; {ratios[0]}, p90 {ratios[1]}; {shares}")
    return told


def _ratio(share: float, pairs: NDArray[np.float64]) -> NDArray[np.float64]:
    """Of the columns' quantiles, (..., n, 2) to (...)."""
    first, second = np.moveaxis(np.quantile(pairs, share, axis=-2, method="higher"), -1, 0)
    return np.asarray(first / second)


def main() -> int:
    parser = problem_arguments(__doc__)
    parser.add_argument("--cameras", type=int, default=1)
    parser.add_argument("--seeds", type=int, default=3, help="of both planners")
    options = parser.parse_args()
    bundle = Bundle.load(options.bundle)
    world = viewed(panda_world(bundle), options.cameras)
    given = options.cameras, options.aim, options.seeds
    rows = [counted(bundle, world, one, *given) for one in chosen_problems(options)]
    kept = [row for row in rows if row is not None]
    print(machine())
    print(f"{len(kept)} {options.split} problems, {options.cameras} cameras, {options.seeds} seeds")
    print("\n".join(lines(kept, np.random.default_rng(0))))
    return 0


if __name__ == "__main__":
    sys.exit(main())
