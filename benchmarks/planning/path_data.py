"""How good the paths are that path models learn from: their length over the best that long searches find.

    python -m benchmarks.planning.path_data --problems 40 --seconds 10

Paths of the exact grid, and of OMPL's RRT* after a quarter of a second and after ``--seconds``; the best
known path is the shortest of these and of BIT* after ``--seconds``. Lengths are on the torus, paths checked
at ten times the planner's resolution. Times are of one path with nothing prepared, the grid's tree included.
"""

import sys
import time
from dataclasses import replace

import numpy as np

from benchmarks.command import arguments
from cspace.problem import Problem
from cspace.splits import Split
from cspace.worlds.planar.planning.grid_paths import PathFinder
from cspace.worlds.planar.planning.problems import Family, draw_problem
from services.evaluator.evaluation.tables import markdown
from services.evaluator.statistics import bootstrap_interval
from services.planner.search.ompl_planner import solve
from services.planner.search.path_check import path_length_rad
from services.planner.settings import BIT_STAR, RRT_STAR, PlannerSettings

SHORT_S = 0.25
GRID, QUICK, LONG, INFORMED = "exact grid", f"RRT*, {SHORT_S} s", "RRT*, long", "BIT*, long"


def lengths(problem: Problem, seconds: float, seed: int) -> tuple[dict[str, float], dict[str, float]]:
    """Length of each way's path in rad, nan without one, and the time that it took in s."""
    found, times = {}, {}
    began = time.perf_counter()
    path = PathFinder(problem.scenario, problem.goal).path_from(problem.start)
    times[GRID] = time.perf_counter() - began
    found[GRID] = float("nan") if path is None else path_length_rad(problem, path)
    settings = PlannerSettings(
        seed=seed, resolution_rad=0.01, max_iterations=2**31 - 1, stop_at_first=False, time_limit_s=seconds
    )
    for name, planner, limit_s in (
        (QUICK, RRT_STAR, SHORT_S),
        (LONG, RRT_STAR, seconds),
        (INFORMED, BIT_STAR, seconds),
    ):
        result = solve(problem, replace(settings, planner=planner, time_limit_s=limit_s))
        found[name], times[name] = float(result.length_rad), result.solve_time_s
    return found, times


def table(rows: list[tuple[dict[str, float], dict[str, float]]]) -> list[list[str]]:
    rng = np.random.default_rng(0)
    best = np.array([np.nanmin(list(found.values())) for found, _ in rows])
    lines = [["paths", "found", "median over the best known", "p90", "time, ms"]]
    for name in (GRID, QUICK, LONG, INFORMED):
        ratio = np.array([found[name] for found, _ in rows]) / best
        solved = ratio[np.isfinite(ratio)]
        median = bootstrap_interval(
            solved[:, None], lambda part: np.asarray(np.median(part[..., 0], axis=-1)), rng
        )
        took = 1e3 * np.median([times[name] for _, times in rows])
        cells = [f"{median:.3f}", f"{np.quantile(solved, 0.9):.3f}", f"{took:.0f}"]
        lines.append([name, f"{len(solved)} of {len(rows)}", *cells])
    return lines


def main() -> int:
    parser = arguments(__doc__)
    parser.add_argument("--problems", type=int, default=40, help="validation problems of each family")
    parser.add_argument("--seconds", type=float, default=10.0, help="of the long searches")
    options = parser.parse_args()
    for family in (Family.NARROW, Family.UNIFORM):
        rows = []
        for index in range(options.problems):
            rows.append(lengths(draw_problem(family, Split.VALIDATION, 1, index), options.seconds, index + 1))
            print(f"{family}: {index + 1}/{options.problems}", file=sys.stderr, flush=True)
        print(f"\n{family}\n\n{markdown(table(rows))}", flush=True)
    return 0


if __name__ == "__main__":
    sys.exit(main())
