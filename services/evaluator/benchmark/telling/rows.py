"""Tables of the benchmark as rows of text, the header first."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from services.evaluator.benchmark.runs.arms import Arm
from services.evaluator.benchmark.summary.break_even import costs_in_words, in_words
from services.evaluator.benchmark.summary.convergence import Convergence
from services.evaluator.benchmark.summary.paired import PairedRuns
from services.evaluator.benchmark.summary.summaries import WITHIN, ArmSummary, Ratios
from services.evaluator.evaluation.tables import Table
from services.evaluator.statistics import CensoredSummary, Interval


def arm_table(summaries: Sequence[ArmSummary]) -> Table:
    """Iterations, checks, success and length of every arm."""
    rows = [
        [
            "arm",
            f"solved within {WITHIN}",
            "paths rejected",
            "iterations",
            "of uniform's median",
            "of its p90",
            "of its best's median",
            "of its best's p90",
            "edge checks",
            "checks of uniform's median",
            "checks of its p90",
            "length of uniform's",
        ]
    ]
    return rows + [
        [
            one.arm.name,
            f"{one.within:.4f}",
            str(one.rejected),
            quantiles(one.iterations),
            *_pair(one.iteration_ratios),
            *_pair(one.own_best_ratios),
            quantiles(one.edge_checks),
            *_pair(one.check_ratios),
            _interval(one.length_ratio),
        ]
        for one in summaries
    ]


def time_table(summaries: Sequence[ArmSummary]) -> Table:
    """Request, solve and whole time of every arm; in brackets the 90th percentile."""
    rows = [
        ["arm", "request, ms", "of it server", "of it transport", "solve, ms", "of it checks", "whole, ms"]
    ]
    for one in summaries:
        parts = one.parts_ms
        request = [
            f"{parts[name][0]:.2f} ({parts[name][1]:.2f})" for name in ("request", "server", "transport")
        ]
        rows.append(
            [
                one.arm.name,
                *(["-"] * 3 if one.arm.sampler is None else request),
                quantiles(one.solve_ms, ".2f"),
                f"{parts['check'][0]:.2f} ({parts['check'][1]:.2f})",
                quantiles(one.total_ms, ".2f"),
            ]
        )
    return rows


def worth_table(summaries: Sequence[ArmSummary]) -> Table:
    """From which cost of a check on learned samples save wall time."""
    over = ("over uniform", "over the best uniform")
    rows = [
        [
            "arm",
            *(f"{what}, {one}" for what in ("edge", "state") for one in over),
            "medians: edge, over uniform",
        ]
    ]
    for one in summaries:
        if one.worth is not None:
            worth = one.worth
            found = (worth.edge_base, worth.edge_best, worth.state_base, worth.state_best)
            rows.append([one.arm.name, *map(in_words, found), costs_in_words(worth.edge_base.typical)])
    return rows


def convergence_table(found: Sequence[Convergence]) -> Table:
    """How soon optimising planners come within 5 % of the best known length."""
    rows = [
        [
            "arm",
            "came within 5 %",
            "iterations until then",
            "of RRT*'s median",
            "of its p90",
            "edge checks",
            "time, ms",
            "first length of RRT*'s",
            "last length of the best known",
        ]
    ]
    for one in found:
        time_ms = replace(one.time_s, median=1e3 * one.time_s.median, p90=1e3 * one.time_s.p90)
        rows.append(
            [
                one.arm.name,
                f"{one.close:.3f}",
                quantiles(one.iterations),
                *_pair(one.iteration_ratios),
                quantiles(one.edge_checks),
                quantiles(time_ms, ".1f"),
                _interval(one.first_length),
                f"{one.final_excess:.3f}",
            ]
        )
    return rows


def give_up_table(runs: PairedRuns, arms: Sequence[Arm]) -> Table:
    """Of problems without a path: false successes, and what it takes until a limit ends the search."""
    rows = [["arm", "false successes", "iterations", "edge checks", "time to give up, ms"]]
    for arm in arms:
        solved = runs.solved(arm.name)
        # Every run is cut off here, and where is the very thing that is measured.
        spent = [runs.values(arm.name, name) for name in ("iterations", "edge_checks", "total_s")]
        cells = [
            f"{scale * np.median(values):.0f} ({scale * np.quantile(values, 0.9):.0f})"
            for values, scale in zip(spent, (1.0, 1.0, 1e3), strict=True)
        ]
        rows.append([arm.name, f"{int(solved.sum())} of {solved.size}", *cells])
    return rows


def quantiles(summary: CensoredSummary, form: str = ".0f") -> str:
    """Median and 90th percentile, each with > where it is only a lower bound."""
    median, p90 = (
        f"{'>' if bound else ''}{value:{form}}"
        for value, bound in ((summary.median, summary.median_is_bound), (summary.p90, summary.p90_is_bound))
    )
    return f"{median} ({p90})"


def _pair(ratios: Ratios | None) -> tuple[str, str]:
    return ("-", "-") if ratios is None else (_interval(ratios.median), _interval(ratios.p90))


def _interval(interval: Interval | None) -> str:
    return "-" if interval is None else f"{interval:.2f}"
