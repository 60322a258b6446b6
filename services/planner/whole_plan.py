"""A problem that the inference API plans whole (``POST /plan``), and its way in the scene as it is."""

import math
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from cspace.planning.paths import spaced
from cspace.query import PlanQuery
from cspace.simulator import Problem
from cspace.worlds import checker_of, picture_file_of, simulator_of
from services.planner.plan_result import PlanResult, Reason
from services.planner.report import problem_line, warning_lines
from services.planner.sources.found_plan import FoundPlan
from services.planner.sources.sampling_client import SamplingClient

# Ways are judged at a tenth of the distance at which planners look.
_FINER = 0.1


@dataclass(frozen=True, slots=True, eq=False)
class WholePlan:
    """What came of it.

    Args:
        problem: that was asked about.
        found: the API's answer.
        clearance_m: least of all states along the way, in the scene as it is; NaN without a way.
    """

    problem: Problem
    found: FoundPlan
    clearance_m: float

    @property
    def free(self) -> bool:
        """Whether there is a way that touches nothing."""
        return self.clearance_m > 0.0

    @property
    def result(self) -> PlanResult:
        """As planners return it, for drawings."""
        plan = self.found.plan
        return PlanResult(
            solved=len(plan.way) > 0,
            path=plan.way,
            length_rad=plan.length_rad if len(plan.way) else math.nan,
            iterations=0,
            edge_checks=0,
            solve_time_s=1e-3 * (plan.search_ms + plan.score_ms),
            learned_drawn=0,
            uniform_drawn=0,
            reason=Reason.SOLVED if len(plan.way) else Reason.NO_PATH,
        )


def ask_for_plan(
    problem: Problem, client: SamplingClient, query: PlanQuery, model: str | None = None
) -> WholePlan:
    """Ask, and judge the way by exact checks.

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
    if len(found.plan.way):
        measures = simulator_of(problem.scenario.world).measures
        states = spaced(found.plan.way, problem.space, _FINER * measures.resolution_rad)
        clearance_m = float(np.min(checker_of(problem.scenario).clearance(states)))
    return WholePlan(problem, found, clearance_m)


def told(whole: WholePlan) -> str:
    """The outcome in words; the last line says what the model could not know."""
    found, plan, model = whole.found, whole.found.plan, whole.found.model
    times = f"{1e3 * found.round_trip_s:.0f} ms: search {plan.search_ms:.0f}, belief {plan.score_ms:.0f}"
    lines = [
        f"problem  {problem_line(whole.problem)}",
        f"plan     {plan.status} by {model.model_name}/{model.model_version} in {times}",
    ]
    if found.reason is not None:
        lines.append(f"reason   {found.reason}")
    lines.extend(warning_lines(model.warnings))
    if len(plan.way):
        unseen = "" if plan.unseen is None else f", up to {plan.unseen.max():.0%} of the robot unseen"
        lines.append(
            f"way      {plan.length_rad:.2f} rad over {len(plan.edges)} edges, the surest of {plan.found}: "
            f"confidence {plan.confidence:.3f}, least {plan.edges.min():.3f}{unseen}"
        )
        outcome = "free" if whole.free else "collides"
        lines.append(f"in truth {outcome}, least clearance {1e3 * whole.clearance_m:.0f} mm")
    return "\n".join(lines)


def as_json(whole: WholePlan) -> dict[str, Any]:
    """The same as plain values."""
    found, plan = whole.found, whole.found.plan
    return {
        "status": plan.status,
        "reason": found.reason,
        "path": plan.way.tolist(),
        "confidence": plan.confidence,
        "edges": plan.edges.tolist(),
        "unseen": None if plan.unseen is None else plan.unseen.tolist(),
        "length_rad": plan.length_rad,
        "ways": plan.found,
        "seed": str(found.seed),
        "model": {"name": found.model.model_name, "version": found.model.model_version},
        "warnings": [asdict(one) for one in found.model.warnings],
        "round_trip_s": found.round_trip_s,
        "in_truth": {"free": whole.free, "clearance_m": whole.clearance_m} if len(plan.way) else None,
    }
