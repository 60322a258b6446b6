"""The API's plan, as the client reads it, in the project's own words."""

from dataclasses import dataclass

import cspace_client
from cspace.query import BelievedWay, Doubt, Plan
from cspace.world import NextView


@dataclass(frozen=True, slots=True, eq=False)
class FoundPlan:
    """A way, or why there is none.

    Args:
        plan: the answer.
        reason: of what is not solved, in the server's words; None of what is.
        seed: that was used.
        model: that answered.
        round_trip_s: from the request to the checked answer, further attempts included.
    """

    plan: Plan
    reason: str | None
    seed: int
    model: cspace_client.ModelHead
    round_trip_s: float


def found_plan(told: cspace_client.FoundPlan) -> FoundPlan:
    """The plan of an answer that the client has judged."""
    plan = told.plan
    least, view = plan.least, plan.next_view
    ours = Plan(
        status=plan.status,
        way=plan.way,
        confidence=plan.confidence,
        edges=plan.edges,
        unseen=plan.unseen,
        length_rad=plan.length_rad,
        found=plan.found,
        least=None
        if least is None
        else Doubt(least.configuration, least.confidence, least.unseen, least.along),
        next_view=None if view is None else NextView(view.camera, view.sees),
        alternatives=tuple(BelievedWay(one.way, one.confidence, one.edges) for one in plan.alternatives),
        search_ms=plan.search_ms,
        score_ms=plan.score_ms,
    )
    return FoundPlan(ours, told.reason, told.seed, told.model, told.round_trip_s)
