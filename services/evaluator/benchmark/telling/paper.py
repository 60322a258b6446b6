"""The columns of the paper's Table 1, and success against how many samples are asked for."""

from collections.abc import Sequence

import numpy as np

from services.evaluator.benchmark.runs.arms import Arm, Group
from services.evaluator.benchmark.summary.paired import PairedRuns
from services.evaluator.benchmark.telling.rows import table_of
from services.evaluator.evaluation.tables import Table
from services.evaluator.statistics import (
    clopper_pearson,
    mean_interval,
    quantile_interval,
    ratio_of_sums_interval,
)

WITHIN_COUNTS = (100, 300, 1000)


def paper_table(runs: PairedRuns, arms: Sequence[Arm], rng: np.random.Generator) -> Table:
    """Path length, running time and success of every arm over all scenarios.

    Lengths are means over the runs with a path. The time is that of the search and, beside it, with the
    request; its means are over all runs, one without a path counted up to its limit. Intervals are over
    scenarios, for success exact over runs.
    """
    rows = []
    for arm in arms:
        solved = runs.solved(arm.name)
        lengths = np.where(solved, np.nan_to_num(runs.values(arm.name, "length_rad")), 0.0).sum(axis=1)
        found = solved.sum(axis=1)
        some = found > 0
        mean_length = "-"
        if some.any():
            mean_length = f"{ratio_of_sums_interval(lengths[some], found[some], rng):.2f}"
        search_ms, whole_ms = (
            mean_interval(1e3 * runs.values(arm.name, name).mean(axis=1), rng)
            for name in ("solve_s", "total_s")
        )
        rows.append(
            {
                "arm": arm.name,
                "path length mean, rad": mean_length,
                "running time mean, ms": f"{search_ms:.2f}",
                "with the request, ms": f"{whole_ms:.2f}",
                "success": f"{clopper_pearson(int(solved.sum()), solved.size):.4f}",
                "scenarios always solved": f"{int(solved.all(axis=1).sum())} of {len(solved)}",
            }
        )
    return table_of(rows)


def counts_table(runs: PairedRuns, arms: Sequence[Arm], rng: np.random.Generator) -> Table:
    """Success and iterations against the number of samples asked for; empty without such arms.

    Iterations are means over the runs of a problem, of which the median is told; a run without success counts
    as much as the longest.
    """
    swept = sorted(
        (arm for arm in arms if arm.group is Group.COUNTS), key=lambda arm: (arm.sampler, arm.samples)
    )
    rows = []
    for arm in swept:
        solved, iterations = runs.solved(arm.name), runs.values(arm.name, "iterations")
        within = {
            count: clopper_pearson(int((solved & (iterations <= count)).sum()), solved.size)
            for count in WITHIN_COUNTS
        }
        ranked = np.where(solved, iterations, iterations.max()).mean(axis=1)
        rows.append(
            {
                "arm": arm.name,
                "samples": str(arm.samples),
                **{f"within {count} iterations": f"{share:.3f}" for count, share in within.items()},
                "solved": f"{clopper_pearson(int(solved.sum()), solved.size):.4f}",
                "iterations: a problem's mean": f"{quantile_interval(ranked, 0.5, rng):.0f}",
            }
        )
    return table_of(rows)
