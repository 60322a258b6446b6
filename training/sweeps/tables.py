"""The tables of a sweep: how far it is, and what came out."""

import math
import statistics
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from services.progress import time_left
from training.sweeps.grid import Point
from training.sweeps.record import MEASURES, PointResult


@dataclass(frozen=True, slots=True)
class Standing:
    """Where a point is.

    Args:
        point: which.
        state: waiting or running, or how it ended.
        doing: its stage or step, while it runs.
        elapsed_s: since it began, while it runs.
    """

    point: Point
    state: str
    doing: str = ""
    elapsed_s: float = 0.0


def seconds_left(standings: Sequence[Standing], seconds: Sequence[float], at_once: int) -> float | None:
    """Time until the last point ends, by the median time of those that have finished; None before one has.

    Args:
        standings: of all points.
        seconds: that finished points took.
        at_once: points that run side by side.
    """
    if not seconds:
        return None
    whole = statistics.median(seconds)
    running = [max(0.0, whole - one.elapsed_s) for one in standings if one.state == "running"]
    waiting = whole * sum(one.state == "waiting" for one in standings)
    # No sooner than the slowest of those that run, and no sooner than all hands need together.
    return max([(sum(running) + waiting) / at_once, *running])


def progress_lines(
    standings: Sequence[Standing], results: Mapping[Point, PointResult], at_once: int
) -> list[str]:
    """A line on the whole, then one for each point that runs or has failed."""
    took = [results[point].seconds for point in results if results[point].state == "finished"]
    counts = {state: sum(one.state == state for one in standings) for state in _STATES}
    counted = ", ".join(f"{count} {state}" for state, count in counts.items() if count)
    left = seconds_left(standings, took, at_once)
    lines = [f"sweep: {counted} of {len(standings)}{time_left(left)}"]
    whole = statistics.median(took) if took else math.nan
    for one in standings:
        if one.state == "running":
            rest = None if math.isnan(whole) else max(0.0, whole - one.elapsed_s)
            doing = one.doing or "starting"
            lines.append(f"  {one.point.title} | running | {doing}{time_left(rest or None)}")
        elif one.state in ("failed", "stopped"):
            lines.append(f"  {one.point.title} | {one.state} | {results[one.point].error}")
    return lines


def final_table(results: Mapping[Point, PointResult], sort: str) -> list[list[str]]:
    """Finished points from best to worst, then failed ones; the header first.

    Args:
        results: of the points.
        sort: one of :data:`training.sweeps.record.MEASURES`.
    """
    worst = math.inf
    sign = 1.0 if MEASURES[sort] else -1.0

    def rank(item: tuple[Point, PointResult]) -> float:
        value = measured(item[1]).get(sort, worst)
        return sign * value if item[1].state == "finished" else worst

    ordered = sorted(results.items(), key=rank)
    keys = [key for key, _ in ordered[0][0].settings] if ordered else []
    rows = [[*keys, *MEASURES, "run"]]
    for point, result in ordered:
        values = measured(result)
        cells = [
            f"{values[name]:.{0 if name == 'seconds' else 3}f}" if name in values else "-"
            for name in MEASURES
        ]
        rows.append([*(str(value) for _, value in point.settings), *cells, result.run_id or result.state])
    return rows


def measured(result: PointResult) -> dict[str, float]:
    """The numbers of the final table."""
    return {**result.metrics, "seconds": result.seconds}


_STATES = ("finished", "running", "waiting", "failed", "stopped")
