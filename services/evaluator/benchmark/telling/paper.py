"""The columns of the paper's Table 1, and success against how many samples are asked for."""

from collections.abc import Sequence

import numpy as np

from services.evaluator.benchmark.runs.arms import Arm, Group
from services.evaluator.benchmark.summary.paired import PairedRuns
from services.evaluator.evaluation.tables import Table
from services.evaluator.statistics import bootstrap_interval, clopper_pearson, quantile_interval

WITHIN_COUNTS = (100, 300, 1000)


def paper_table(runs: PairedRuns, arms: Sequence[Arm], rng: np.random.Generator) -> Table:
    """Path length, running time and success of every arm over all scenarios.

    Lengths are means over the runs with a path. The time is that of the search and, beside it, with the
    request; its means are over all runs, one without a path counted up to its limit. Intervals are over
    scenarios, for success exact over runs.
    """
    rows = [
        [
            "arm",
            "path length mean, rad",
            "running time mean, ms",
            "with the request, ms",
            "success",
            "scenarios always solved",
        ]
    ]
    for arm in arms:
        solved = runs.solved(arm.name)
        lengths = np.where(solved, np.nan_to_num(runs.values(arm.name, "length_rad")), 0.0)
        times = [1e3 * runs.values(arm.name, name).mean(axis=1) for name in ("solve_s", "total_s")]
        mean_length = "-"
        if solved.any():
            sums = np.stack([lengths.sum(axis=1), solved.sum(axis=1)], axis=1)
            mean_length = f"{bootstrap_interval(sums[sums[:, 1] > 0], _mean, rng):.2f}"
        rows.append(
            [
                arm.name,
                mean_length,
                *(
                    f"{bootstrap_interval(time, lambda part: part[..., 0].mean(axis=-1), rng):.2f}"
                    for time in times
                ),
                f"{clopper_pearson(int(solved.sum()), solved.size):.4f}",
                f"{int(solved.all(axis=1).sum())} of {len(solved)}",
            ]
        )
    return rows


def counts_table(runs: PairedRuns, arms: Sequence[Arm], rng: np.random.Generator) -> Table:
    """Success and iterations against the number of samples asked for; empty without such arms.

    Iterations are means over the runs of a problem, of which the median is told; a run without success counts
    as much as the longest.
    """
    swept = sorted(
        (arm for arm in arms if arm.group is Group.COUNTS), key=lambda arm: (arm.sampler, arm.samples)
    )
    rows = [
        [
            "arm",
            "samples",
            *(f"within {count} iterations" for count in WITHIN_COUNTS),
            "solved",
            "iterations: a problem's mean",
        ]
    ]
    for arm in swept:
        solved, iterations = runs.solved(arm.name), runs.values(arm.name, "iterations")
        within = [
            clopper_pearson(int((solved & (iterations <= count)).sum()), solved.size)
            for count in WITHIN_COUNTS
        ]
        ranked = np.where(solved, iterations, iterations.max()).mean(axis=1)
        rows.append(
            [
                arm.name,
                str(arm.samples),
                *(f"{share:.3f}" for share in within),
                f"{clopper_pearson(int(solved.sum()), solved.size):.4f}",
                f"{quantile_interval(ranked, 0.5, rng):.0f}",
            ]
        )
    return rows if swept else []


def _mean(
    rows: np.ndarray[tuple[int, ...], np.dtype[np.float64]],
) -> np.ndarray[tuple[int, ...], np.dtype[np.float64]]:
    sums = rows.sum(axis=-2)
    return np.asarray(sums[..., 0] / sums[..., 1])
