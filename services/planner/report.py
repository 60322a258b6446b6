"""The outcome of a comparison, or of the API's own plan, as text and as JSON, and reported to the API."""

import math
from collections.abc import Iterable
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from cspace.planning.paths import spaced
from cspace.query import PlanQuery
from cspace.simulator import OWN, Problem
from cspace.worlds import checker_of, picture_file_of, simulator_of
from cspace_client import OutcomeSender, PictureWarning
from services.planner.client import FoundPlan, SamplingClient
from services.planner.planning import Comparison
from services.planner.result import PlanResult, Reason

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
            "warnings": [one.model_dump() for one in batch.warnings],
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


def report_samples(comparison: Comparison, sender: OutcomeSender) -> None:
    """Checks all samples of the API and reports how many are free."""
    batch = comparison.learned.batch
    if batch is not None and len(batch.samples):
        free = np.count_nonzero(checker_of(comparison.problem.scenario).valid_batch(batch.samples))
        sender.samples(batch, checked=len(batch.samples), free=int(free))


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
    words = (problem.family, f"seed {problem.seed}", f"{problem.space.dim} joints", problem.passage)
    return ", ".join(filter(None, words))


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


# Paths are checked at a tenth of the resolution of the planners.
_FINER = 0.1


@dataclass(frozen=True, slots=True, eq=False)
class WholePlan:
    """What came of it.

    Args:
        problem: that was asked about.
        found: the API's answer.
        clearance_m: least of all states along the path, in the scene as it is; NaN without a path.
    """

    problem: Problem
    found: FoundPlan
    clearance_m: float

    @property
    def free(self) -> bool:
        """Whether there is a path that touches nothing."""
        return self.clearance_m > 0.0

    def report(self, sender: OutcomeSender) -> None:
        """Reports whether the path is free; nothing moved along it."""
        sender.plan(
            self.found,
            success=self.free,
            executed=False,
            collided=not self.free if len(self.found.path) else None,
            time_s=self.found.round_trip_s,
        )

    @property
    def result(self) -> PlanResult:
        """As planners return it, for drawings."""
        plan = self.found
        return PlanResult(
            solved=len(plan.path) > 0,
            path=plan.path,
            length_rad=plan.length_rad if len(plan.path) else math.nan,
            solve_time_s=1e-3 * (plan.timing_ms.search + plan.timing_ms.score),
            reason=Reason.SOLVED if len(plan.path) else Reason.NO_PATH,
        )


def ask_for_plan(
    problem: Problem, client: SamplingClient, query: PlanQuery, model: str | None = None
) -> WholePlan:
    """Requests a plan and checks its path against the true scene.

    Args:
        problem: start and goal in a scene.
        client: of the API.
        query: with the problem's start and goal.
        model: as the client has it.

    Raises:
        SamplerError: as the client has it.
    """
    found = client.plan(picture_file_of(problem.scenario), query, model)
    clearance_m = math.nan
    if len(found.path):
        measures = simulator_of(problem.scenario.world).measures
        states = spaced(found.path, problem.space, _FINER * measures.resolution_rad)
        clearance_m = float(np.min(checker_of(problem.scenario).clearance(states)))
    return WholePlan(problem, found, clearance_m)


def plan_text(whole: WholePlan) -> str:
    """The outcome in words; the last line is the ground truth."""
    plan, model = whole.found, whole.found.model
    times = (
        f"{1e3 * plan.round_trip_s:.0f} ms: search {plan.timing_ms.search:.0f}, "
        f"scoring {plan.timing_ms.score:.0f}"
    )
    lines = [
        f"problem  {problem_line(whole.problem)}",
        f"plan     {plan.status} by {model.name}/{model.version} in {times}",
    ]
    if plan.reason is not None:
        lines.append(f"reason   {plan.reason}")
    lines.extend(warning_lines(plan.warnings))
    if len(plan.path):
        unseen = (
            "" if plan.unseen is None else f", up to {plan.unseen.max():.0%} of the robot in unknown space"
        )
        lines.append(
            f"path     {plan.length_rad:.2f} rad over {len(plan.edges)} edges, the best of {plan.ways}: "
            f"confidence {plan.confidence:.3f}, lowest {plan.edges.min():.3f}{unseen}"
        )
        outcome = "collision-free" if whole.free else "collides"
        lines.append(f"truth    {outcome}, minimum clearance {1e3 * whole.clearance_m:.0f} mm")
    return "\n".join(lines)


def as_json(whole: WholePlan) -> dict[str, Any]:
    """The same as plain values."""
    plan = whole.found
    return {
        "status": plan.status,
        "reason": plan.reason,
        "path": plan.path.tolist(),
        "confidence": plan.confidence,
        "edges": plan.edges.tolist(),
        "unseen": None if plan.unseen is None else plan.unseen.tolist(),
        "length_rad": plan.length_rad,
        "ways": plan.ways,
        "seed": str(plan.seed),
        "model": {"name": plan.model.name, "version": plan.model.version},
        "warnings": [one.model_dump() for one in plan.warnings],
        "round_trip_s": plan.round_trip_s,
        "in_truth": {"free": whole.free, "clearance_m": whole.clearance_m} if len(plan.path) else None,
    }
