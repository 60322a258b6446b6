"""The outcome of a comparison as a small table and as JSON."""

import math
from collections.abc import Iterable
from dataclasses import asdict
from typing import Any

from cspace.simulator import OWN, Problem
from cspace_client import PictureWarning
from services.planner.plan_result import PlanResult
from services.planner.planning import Comparison

_HEADINGS = (
    "planner", "outcome", "iterations", "edges", "states", "learned", "uniform", "length rad", "time ms",
)  # fmt: skip


def comparison_table(comparison: Comparison, planner: str) -> str:
    """Problem, samples and one line for each run."""
    cells = [
        _HEADINGS,
        *(_row(name, result) for name, result in named_results(comparison, planner)),
    ]
    widths = [max(len(row[column]) for row in cells) for column in range(len(_HEADINGS))]
    # Words to the left, numbers to the right.
    lines = [
        "  ".join(
            cell.ljust(width) if column < 2 else cell.rjust(width)
            for column, (cell, width) in enumerate(zip(row, widths, strict=True))
        ).rstrip()
        for row in cells
    ]
    batch = comparison.learned.batch
    head = [f"problem  {problem_line(comparison.problem)}", f"samples  {_samples_line(comparison)}"]
    return "\n".join([*head, *warning_lines(() if batch is None else batch.warnings), "", *lines])


def warning_lines(warnings: Iterable[PictureWarning]) -> list[str]:
    """What is wrong, or may be, with a problem's pictures, a line each."""
    return [f"warning  {one.code}: {one.message}" for one in warnings]


def comparison_json(comparison: Comparison, planner: str) -> dict[str, Any]:
    """The same as plain values; a number that does not exist is null."""
    problem, batch = comparison.problem, comparison.learned.batch
    samples = None
    if batch is not None:
        samples = {
            "count": len(batch.samples),
            "shortfall": batch.shortfall,
            "model": {"name": batch.model_name, "version": batch.model_version, "digest": batch.digest},
            "seed": str(batch.seed),
            "round_trip_s": batch.round_trip_s,
            "novelty": batch.novelty,
            "warnings": [asdict(one) for one in batch.warnings],
            "uniform_share": comparison.learned.uniform_share,
        }
    return {
        "problem": {
            "family": str(problem.family),
            "seed": problem.seed,
            "bottleneck_rad": _number(problem.bottleneck_rad),
            "start": problem.start.tolist(),
            "goal": problem.goal.tolist(),
            "scenario": problem.scenario.to_dict(),
        },
        "samples": samples,
        "sampler_unavailable": comparison.learned.unavailable,
        "runs": {name: _run(result) for name, result in named_results(comparison, planner)},
    }


def named_results(comparison: Comparison, planner: str) -> list[tuple[str, PlanResult]]:
    """The runs of a comparison by name, the one with the API's samples first."""
    first = "learned" if comparison.learned.batch is not None else "no samples"
    return [
        (f"{planner}, {first}", comparison.learned.result),
        (f"{planner}, uniform", comparison.uniform),
        ("RRTConnect, uniform", comparison.connect),
    ]


def problem_line(problem: Problem) -> str:
    """A problem in a few words."""
    if problem.family == OWN:
        return f"your own, {problem.space.dim} joints"
    passage = (
        f"bottleneck {problem.bottleneck_rad:.3f} rad"
        if 0.0 < problem.bottleneck_rad < math.inf
        else "no path"
        if problem.bottleneck_rad == 0.0
        else "nothing in reach"
    )
    return f"{problem.family}, seed {problem.seed}, {problem.space.dim} joints, {passage}"


def _samples_line(comparison: Comparison) -> str:
    batch = comparison.learned.batch
    if batch is None:
        return f"none, going on with uniform samples: {comparison.learned.unavailable}"
    dropped = f" ({batch.shortfall} too few)" if batch.shortfall else ""
    new = "" if batch.novelty is None else f", novelty {batch.novelty:.2f}"
    return (
        f"{len(batch.samples)}{dropped} from {batch.model_name}/{batch.model_version} "
        f"(digest {batch.digest[:12]}, seed {batch.seed}) in {1e3 * batch.round_trip_s:.1f} ms{new}"
    )


def _row(name: str, result: PlanResult) -> tuple[str, ...]:
    return (
        name,
        str(result.reason),
        str(result.iterations),
        str(result.edge_checks),
        str(result.state_checks),
        str(result.learned_drawn),
        str(result.uniform_drawn),
        f"{result.length_rad:.2f}" if result.solved else "-",
        f"{1e3 * result.solve_time_s:.2f}",
    )


def _run(result: PlanResult) -> dict[str, Any]:
    return {
        "solved": result.solved,
        "reason": str(result.reason),
        "iterations": result.iterations,
        "edge_checks": result.edge_checks,
        "state_checks": result.state_checks,
        "resolution_rad": _number(result.resolution_rad),
        "learned_drawn": result.learned_drawn,
        "uniform_drawn": result.uniform_drawn,
        "length_rad": _number(result.length_rad),
        "solve_time_s": result.solve_time_s,
        "costs": [asdict(point) for point in result.costs],
        "path": result.path.tolist(),
    }


def _number(value: float) -> float | None:
    return value if math.isfinite(value) else None
