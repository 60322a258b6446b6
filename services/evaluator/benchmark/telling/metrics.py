"""The benchmark as flat numbers by name, for the tracking server."""

import math
import re
from collections.abc import Iterator
from typing import Any

from services.evaluator.benchmark.summary.convergence import Convergence
from services.evaluator.benchmark.summary.results import Results
from services.evaluator.benchmark.summary.summaries import ArmSummary, Ratios
from services.evaluator.statistics import Interval


def flat_metrics(results: Results) -> dict[str, float]:
    """Family, arm and measure, as in ``narrow/RRT_way_70/iterations_ratio_median``; finite ones alone.

    Intervals end in ``_low`` and ``_high``. A break-even cost is in us; it lacks where there is none.
    """
    found: dict[str, float] = {}
    for family, result in results.families.items():
        for one in result.summaries:
            found |= {f"{family}/{metric_name(one.arm.name)}/{name}": value for name, value in _arm(one)}
        for way in result.convergence:
            found |= {f"{family}/{metric_name(way.arm.name)}/{name}": value for name, value in _way(way)}
    return {name: value for name, value in found.items() if math.isfinite(value)}


def run_metrics(results: Results) -> dict[str, float]:
    """Of every family and arm what is compared first; all the rest stands in the table of arms."""
    names = ("solved", "iterations_median", "edge_checks_median", "iterations_ratio_median")
    return {name: value for name, value in flat_metrics(results).items() if name.endswith(names)}


def arm_columns(results: Results) -> dict[str, list[Any]]:
    """Every number of :func:`flat_metrics`, one row each: family, arm, measure, value and limits."""
    found = flat_metrics(results)
    limits = ("_low", "_high")
    told = {name: value for name, value in found.items() if not name.endswith(limits)}
    places = [name.split("/") for name in told]
    return {
        "family": [place[0] for place in places],
        "arm": [place[1] for place in places],
        "measure": [place[2] for place in places],
        "value": list(told.values()),
        **{limit[1:]: [found.get(name + limit) for name in told] for limit in limits},
    }


def metric_name(arm: str) -> str:
    """An arm's name as a part of a metric's."""
    return re.sub(r"[^A-Za-z0-9.-]+", "_", arm.replace("*", "star")).strip("_")


def _arm(one: ArmSummary) -> Iterator[tuple[str, float]]:
    yield from _interval("solved", one.solved)
    yield from _interval("within_1000", one.within)
    for name in ("iterations", "edge_checks", "solve_ms", "total_ms"):
        summary = getattr(one, name)
        yield from ((f"{name}_median", summary.median), (f"{name}_p90", summary.p90))
    yield from ((f"{name}_ms_median", value[0]) for name, value in one.parts_ms.items())
    yield from _ratios("iterations_ratio", one.iteration_ratios)
    yield from _ratios("edge_checks_ratio", one.check_ratios)
    yield from _ratios("iterations_ratio_own_best", one.own_best_ratios)
    if one.length_ratio is not None:
        yield from _interval("length_ratio", one.length_ratio)
    if one.worth is not None:
        for name in ("edge_base", "edge_best", "state_base", "state_best"):
            found = getattr(one.worth, name)
            yield f"break_even_{name}_us", 1e6 * found.costs.low_s
            yield f"break_even_{name}_us_low", 1e6 * found.low_s[0]
            yield f"break_even_{name}_us_high", 1e6 * found.low_s[1]


def _way(one: Convergence) -> Iterator[tuple[str, float]]:
    yield from _interval("close", one.close)
    yield from (
        ("close_iterations_median", one.iterations.median),
        ("close_iterations_p90", one.iterations.p90),
    )
    yield from _ratios("close_iterations_ratio", one.iteration_ratios)
    yield "final_excess", one.final_excess


def _ratios(name: str, ratios: Ratios | None) -> Iterator[tuple[str, float]]:
    if ratios is not None:
        yield from _interval(f"{name}_median", ratios.median)
        yield from _interval(f"{name}_p90", ratios.p90)


def _interval(name: str, interval: Interval) -> Iterator[tuple[str, float]]:
    yield from ((name, interval.estimate), (f"{name}_low", interval.low), (f"{name}_high", interval.high))
