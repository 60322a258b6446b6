"""Tables of the benchmark as rows of text, the header first."""

from collections.abc import Sequence

from services.evaluator.benchmark.break_even import BreakEven, in_words
from services.evaluator.benchmark.summary import WITHIN, ArmSummary, Ratios
from services.evaluator.statistics import CensoredSummary, Interval
from services.evaluator.tables import Table


def arm_table(summaries: Sequence[ArmSummary]) -> Table:
    """Iterations, checks, success and length of every arm."""
    rows = [
        [
            "arm",
            f"solved within {WITHIN}",
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
    """Request, solve and whole time of every arm, and the break-even costs of a check."""
    rows = [
        ["arm", "request, ms", "solve, ms", "whole, ms", "wins over uniform", "wins over the best uniform"]
    ]
    for one in summaries:
        request = "-" if one.arm.sampler is None else f"{one.request_ms[0]:.2f} ({one.request_ms[1]:.2f})"
        rows.append(
            [
                one.arm.name,
                request,
                quantiles(one.solve_ms, ".2f"),
                quantiles(one.total_ms, ".2f"),
                _words(one.break_even_base),
                _words(one.break_even_best),
            ]
        )
    return rows


def give_up_table(summaries: Sequence[ArmSummary]) -> Table:
    """Of problems without a path: false successes, and what it takes to give up."""
    rows = [["arm", "false successes", "iterations", "edge checks", "time to give up, ms"]]
    for one in summaries:
        false = round(one.solved.estimate * one.solved.count)
        spent = (one.iterations, one.edge_checks, one.total_ms)
        # Every run is cut off here, which is no bound but the very thing that is measured.
        cells = [f"{part.median:.4g} ({part.p90:.4g})" for part in spent]
        rows.append([one.arm.name, f"{false} of {one.solved.count}", *cells])
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


def _words(found: BreakEven | None) -> str:
    return "-" if found is None else in_words(found)
