"""Tables of the benchmark as rows of text, the header first."""

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from services.evaluator.benchmark.runs.arms import Arm
from services.evaluator.benchmark.summary.break_even import costs_in_words, in_words
from services.evaluator.benchmark.summary.convergence import Convergence
from services.evaluator.benchmark.summary.paired import PairedRuns
from services.evaluator.benchmark.summary.summaries import WITHIN, ArmSummary, Ratios
from services.evaluator.evaluation.tables import Table
from services.evaluator.statistics import CensoredSummary, Interval


def table_of(rows: Sequence[Mapping[str, str]]) -> Table:
    """The table of rows whose cells are named by their headings, the same in each; empty without rows."""
    return [list(rows[0]), *(list(row.values()) for row in rows)] if rows else []


def arm_table(summaries: Sequence[ArmSummary]) -> Table:
    """Iterations, checks, success and length of every arm."""
    return table_of(
        [
            {
                "arm": one.arm.name,
                f"solved within {WITHIN}": f"{one.within:.4f}",
                "paths rejected": str(one.rejected),
                "iterations": quantiles(one.iterations),
                **_pair("of uniform's median", "of its p90", one.iteration_ratios),
                **_pair("of its best's median", "of its best's p90", one.own_best_ratios),
                "edge checks": quantiles(one.edge_checks),
                **_pair("checks of uniform's median", "checks of its p90", one.check_ratios),
                "length of uniform's": _interval(one.length_ratio),
            }
            for one in summaries
        ]
    )


def time_table(summaries: Sequence[ArmSummary]) -> Table:
    """Request, solve and whole time of every arm; in brackets the 90th percentile."""
    rows = []
    for one in summaries:
        parts = {name: f"{median:.2f} ({p90:.2f})" for name, (median, p90) in one.parts_ms.items()}
        request = dict.fromkeys(parts, "-") if one.arm.sampler is None else parts
        rows.append(
            {
                "arm": one.arm.name,
                "request, ms": request["request"],
                "of it server": request["server"],
                "of it transport": request["transport"],
                "solve, ms": quantiles(one.solve_ms, ".2f"),
                "of it checks": parts["check"],
                "whole, ms": quantiles(one.total_ms, ".2f"),
            }
        )
    return table_of(rows)


def worth_table(summaries: Sequence[ArmSummary]) -> Table:
    """From which cost of a check on learned samples save wall time."""
    return table_of(
        [
            {
                "arm": one.arm.name,
                "edge, over uniform": in_words(one.worth.edge_base),
                "edge, over the best uniform": in_words(one.worth.edge_best),
                "state, over uniform": in_words(one.worth.state_base),
                "state, over the best uniform": in_words(one.worth.state_best),
                "medians: edge, over uniform": costs_in_words(one.worth.edge_base.typical),
            }
            for one in summaries
            if one.worth is not None
        ]
    )


def convergence_table(found: Sequence[Convergence]) -> Table:
    """How soon optimising planners come within 5 % of the best known length."""
    rows = []
    for one in found:
        time_ms = replace(one.time_s, median=1e3 * one.time_s.median, p90=1e3 * one.time_s.p90)
        rows.append(
            {
                "arm": one.arm.name,
                "came within 5 %": f"{one.close:.3f}",
                "iterations until then": quantiles(one.iterations),
                **_pair("of RRT*'s median", "of its p90", one.iteration_ratios),
                "edge checks": quantiles(one.edge_checks),
                "time, ms": quantiles(time_ms, ".1f"),
                "first length of RRT*'s": _interval(one.first_length),
                "last length of the best known": f"{one.final_excess:.3f}",
            }
        )
    return table_of(rows)


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


def _pair(of_median: str, of_p90: str, ratios: Ratios | None) -> dict[str, str]:
    median, p90 = (None, None) if ratios is None else (ratios.median, ratios.p90)
    return {of_median: _interval(median), of_p90: _interval(p90)}


def _interval(interval: Interval | None) -> str:
    return "-" if interval is None else f"{interval:.2f}"
