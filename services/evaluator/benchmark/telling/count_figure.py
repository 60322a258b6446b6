"""A figure of success against how many samples are asked for."""

from collections.abc import Sequence

import numpy as np
from matplotlib import rc_context
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from services.evaluator.benchmark.runs.arms import Arm
from services.evaluator.benchmark.summary.paired import PairedRuns
from services.evaluator.benchmark.telling.curves import STYLE, looks
from services.evaluator.benchmark.telling.paper import WITHIN_COUNTS
from services.evaluator.statistics import clopper_pearson


def count_figure(runs: PairedRuns, arms: Sequence[Arm]) -> Figure:
    """Share solved within some numbers of iterations, a panel each, with exact 95 % limits.

    Args:
        runs: of one family.
        arms: that differ in how many samples they ask for; one line a sampler.
    """
    samplers = list(dict.fromkeys(arm.sampler for arm in arms))
    look = looks(arms)
    with rc_context(STYLE):
        figure = Figure(figsize=(11.5, 3.9), dpi=110, layout="constrained")
        FigureCanvasAgg(figure)
        grid = figure.subplots(1, len(WITHIN_COUNTS), sharey=True)
        for axes, within in zip(grid, WITHIN_COUNTS, strict=True):
            for sampler in samplers:
                mine = sorted((arm for arm in arms if arm.sampler == sampler), key=lambda arm: arm.samples)
                shares = [_share(runs, arm, within) for arm in mine]
                middle, low, high = np.transpose(shares)
                axes.errorbar(
                    [arm.samples for arm in mine], middle, [middle - low, high - middle],
                    color=look[mine[0].name].colour, marker="o", markersize=4, capsize=3, label=sampler,
                )  # fmt: skip
            axes.set_xscale("log")
            axes.set_xlabel("samples asked for")
            axes.set_title(f"within {within} iterations")
            axes.set_ylim(-0.02, 1.02)
        grid[0].set_ylabel("share solved")
        grid[-1].legend(loc="lower right", frameon=False, fontsize=8)
        figure.suptitle(f"RRT on {runs.family} problems against the number of learned samples")
    return figure


def _share(runs: PairedRuns, arm: Arm, within: int) -> tuple[float, float, float]:
    solved = runs.solved(arm.name) & (runs.values(arm.name, "iterations") <= within)
    found = clopper_pearson(int(solved.sum()), solved.size)
    return found.estimate, found.low, found.high
