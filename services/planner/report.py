"""What came of a problem, as text, JSON and a report to the API: a comparison, or the API's own plan."""

import math
from collections.abc import Iterable
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np
from tabulate import tabulate

from cspace.planning.paths import spaced
from cspace.query import PlanQuery
from cspace.simulator import OWN, Problem
from cspace.worlds import checker_of, picture_file_of, simulator_of
from cspace_client import OutcomeSender, PictureWarning
from services.planner.client import FoundPlan, SamplingClient
from services.planner.ompl_planner import DEFAULT_UNIFORM_SHARE, solve
from services.planner.planning import SampledPlan, SampleRequest, plan
from services.planner.result import CHECK_FACTOR, PlanResult, Reason
from services.planner.samples import SampleSource
from services.planner.settings import RRT_CONNECT, PlannerSettings

_HEADINGS = (
    "planner", "outcome", "iterations", "edges", "states", "learned", "uniform", "length rad", "time ms",
)  # fmt: skip


@dataclass(frozen=True, slots=True, eq=False)
class Comparison:
    """One problem solved under one seed with learned samples, with uniform ones, and by OMPL's RRTConnect."""

    problem: Problem
    planner: str
    learned: SampledPlan
    uniform: PlanResult
    connect: PlanResult

    @property
    def results(self) -> dict[str, PlanResult]:
        """The runs by name, the one with the source's samples first."""
        first = "learned" if self.learned.batch is not None else "no samples"
        return {
            f"{self.planner}, {first}": self.learned.result,
            f"{self.planner}, uniform": self.uniform,
            "RRTConnect, uniform": self.connect,
        }


def compare(
    problem: Problem,
    source: SampleSource,
    settings: PlannerSettings,
    request: SampleRequest | None = None,
    uniform_share: float = DEFAULT_UNIFORM_SHARE,
) -> Comparison:
    """Solves the problem in all three ways and keeps the trees."""
    learned = plan(problem, source, settings, request, uniform_share, keep_tree=True)
    uniform = solve(problem, settings, keep_tree=True)
    connect = solve(problem, replace(settings, planner=RRT_CONNECT), keep_tree=True)
    return Comparison(problem, settings.planner, learned, uniform, connect)


def comparison_text(comparison: Comparison) -> str:
    """Problem, samples and one line for each run."""
    batch = comparison.learned.batch
    samples = f"none, going on with uniform samples: {comparison.learned.unavailable}"
    if batch is not None:
        dropped = f" ({batch.shortfall} too few)" if batch.shortfall else ""
        new = "" if batch.novelty is None else f", novelty {batch.novelty:.2f}"
        samples = (
            f"{len(batch.samples)}{dropped} from {batch.model_name}/{batch.model_version} "
            f"(digest {batch.digest[:12]}, seed {batch.seed}) in {1e3 * batch.round_trip_s:.1f} ms{new}"
        )
    rows = [
        (
            name, str(result.reason), result.iterations, result.edge_checks, result.state_checks,
            result.learned_drawn, result.uniform_drawn,
            f"{result.length_rad:.2f}" if result.solved else "-", f"{1e3 * result.solve_time_s:.2f}",
        )
        for name, result in comparison.results.items()
    ]  # fmt: skip
    align = ("left", "left", *["right"] * 7)
    table = tabulate(rows, _HEADINGS, tablefmt="plain", disable_numparse=True, colalign=align)
    head = [f"problem  {problem_line(comparison.problem)}", f"samples  {samples}"]
    return "\n".join([*head, *warning_lines(() if batch is None else batch.warnings), "", table])


def comparison_json(comparison: Comparison) -> dict[str, Any]:
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
        "runs": {name: _run(result) for name, result in comparison.results.items()},
    }


def _run(result: PlanResult) -> dict[str, Any]:
    values = asdict(replace(result, tree=None))
    del values["tree"]
    numbers = {name: _number(values[name]) for name in ("resolution_rad", "length_rad")}
    return values | numbers | {"reason": str(result.reason), "path": result.path.tolist()}


def _number(value: float) -> float | None:
    return value if math.isfinite(value) else None


def report_samples(comparison: Comparison, sender: OutcomeSender) -> None:
    """Checks all samples of the API and reports how many are free."""
    batch = comparison.learned.batch
    if batch is not None and len(batch.samples):
        free = np.count_nonzero(checker_of(comparison.problem.scenario).valid_batch(batch.samples))
        sender.samples(batch, checked=len(batch.samples), free=int(free))


def problem_line(problem: Problem) -> str:
    """A problem in a few words."""
    if problem.family == OWN:
        return f"your own, {problem.space.dim} joints"
    words = (problem.family, f"seed {problem.seed}", f"{problem.space.dim} joints", problem.passage)
    return ", ".join(filter(None, words))


def warning_lines(warnings: Iterable[PictureWarning]) -> list[str]:
    """What is wrong, or may be, with a problem's pictures, a line each."""
    return [f"warning  {one.code}: {one.message}" for one in warnings]


@dataclass(frozen=True, slots=True, eq=False)
class WholePlan:
    """The API's plan for a problem, checked against the true scene."""

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
        """As planners return it, for plots."""
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
    """Requests a plan and checks its path against the true scene."""
    found = client.plan(picture_file_of(problem.scenario), query, model)
    clearance_m = math.nan
    if len(found.path):
        step_rad = simulator_of(problem.scenario.world).measures.resolution_rad / CHECK_FACTOR
        states = spaced(found.path, problem.space, step_rad)
        clearance_m = float(np.min(checker_of(problem.scenario).clearance(states)))
    return WholePlan(problem, found, clearance_m)


def plan_text(whole: WholePlan) -> str:
    """The outcome in words; the last line is the ground truth."""
    plan, model = whole.found, whole.found.model
    parts = f"search {plan.timing_ms.search:.0f}, scoring {plan.timing_ms.score:.0f}"
    times = f"{1e3 * plan.round_trip_s:.0f} ms: {parts}"
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


def plan_json(whole: WholePlan) -> dict[str, Any]:
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
