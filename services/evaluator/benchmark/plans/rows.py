"""Tables of the benchmark of plans as rows of text, the header first."""

from collections.abc import Mapping, Sequence

import numpy as np

from services.evaluator.benchmark.plans.checked import ArmChecks
from services.evaluator.benchmark.plans.unchecked import ArmPlans, Sureness
from services.evaluator.benchmark.summary.break_even import in_words
from services.evaluator.benchmark.telling.rows import quantiles, table_of
from services.evaluator.evaluation.tables import Table
from services.evaluator.statistics import Interval

SHARES = (0.2, 0.4, 0.6, 0.8, 1.0)
NOT_LOOKED_AT = "not looked at"


def plans_table(summaries: Sequence[ArmPlans]) -> Table:
    """Solved and collided, of every arm."""
    return table_of(
        [
            {
                "arm": one.arm,
                "solved": f"{one.solved:.2f}",
                "refused": f"{one.refused.estimate:.2f}",
                "collide": _interval(one.collide),
                "deeper than 1 cm": _interval(one.deep),
                "by meshes": _interval(one.meshes, NOT_LOOKED_AT if one.collide else "-"),
                "more than with unseen free": _interval(one.more),
                "search, ms: p50, p95": "{:.0f}, {:.0f}".format(*one.search_ms),
                "scoring, ms": "{:.0f}, {:.0f}".format(*one.score_ms) if any(one.score_ms) else "-",
            }
            for one in summaries
        ]
    )


def share_table(heading: str, shares: Mapping[str, Mapping[str, Interval | None]]) -> Table:
    """Of the ways of each arm the share that collides, a row a group; how many ways in brackets."""
    return table_of(
        [
            {heading: group}
            | {
                arm: "-" if one is None else f"{one.estimate:.2f} ({one.count})"
                for arm, one in by_arm.items()
            }
            for group, by_arm in shares.items()
        ]
    )


def sureness_table(found: Sequence[Sureness]) -> Table:
    """What collides if only so many of the problems are answered, by the surest ways."""
    rows = []
    for one in found:
        for share in SHARES:
            # Up to rounding of k / n.
            taken = int((one.share <= share + 1e-9).sum())
            if taken:
                rows.append(
                    {
                        "model": one.model,
                        "answered, at most": f"{share:.1f}",
                        "answered": f"{one.share[taken - 1]:.2f}",
                        "min_confidence": f"{one.least[taken - 1]:.3f}",
                        "collide": f"{one.collide[taken - 1]:.3f}",
                    }
                )
    return table_of(rows)


def checks_table(groups: Mapping[str, Sequence[ArmChecks]]) -> Table:
    """Checks until the first path, of every group and arm."""
    return table_of(
        [
            {
                "problems": f"{group} ({one.counts['state_checks'].count})",
                "arm": one.arm,
                "solved": f"{one.solved:.2f}",
                "free as it was": "-" if one.as_is is None else f"{one.as_is:.2f}",
                "states": quantiles(one.counts["state_checks"]),
                "of uniform's median": _interval(None if one.ratios is None else one.ratios[0]),
                "of its p90": _interval(None if one.ratios is None else one.ratios[1]),
                "edges": quantiles(one.counts["edge_checks"]),
                "iterations": quantiles(one.counts["iterations"]),
                "length of uniform's": _interval(one.length),
            }
            for group, summaries in groups.items()
            for one in summaries
        ]
    )


def price_table(groups: Mapping[str, Sequence[ArmChecks]]) -> Table:
    """Times until the first path, by what a look at a state costs."""
    return table_of(
        [
            {
                "problems": group,
                "arm": one.arm,
                "ways, ms": f"{one.request_ms:.1f}",
                "search with checks, ms": f"{one.solve_ms:.1f}",
                "all, spheres, ms": f"{one.spheres_ms:.1f}",
                "all, meshes, ms": NOT_LOOKED_AT if one.meshes_ms is None else f"{one.meshes_ms:.1f}",
                "faster than uniform if a look costs": "-" if one.worth is None else in_words(one.worth),
            }
            for group, summaries in groups.items()
            for one in summaries
        ]
    )


def prices_us(runs: Sequence[object]) -> tuple[float | None, float | None]:
    """Median price of a look at a state, by spheres and by meshes, in us; None where none was measured."""
    found = []
    for column in ("state_check_s", "mesh_check_s"):
        told = [value for run in runs if (value := getattr(run, column)) is not None]
        found.append(1e6 * float(np.median(told)) if told else None)
    return found[0], found[1]


def _interval(one: Interval | None, nothing: str = "-") -> str:
    return nothing if one is None else f"{one:.2f}"
