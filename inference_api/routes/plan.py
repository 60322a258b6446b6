"""``POST /plan``: a path from start to goal that the model predicts to be free, or why there is none."""

import time
from collections.abc import Sequence
from dataclasses import replace
from typing import Annotated

import numpy as np
from fastapi import APIRouter, Depends, Request
from fastapi.responses import Response

from cspace.bundle.spec import fitted_plan, fitted_problem, require_robot
from cspace.errors import InputError
from cspace.plan import planning_space
from cspace.query import Plan, PlanQuery, random_seed
from cspace.space import LIMIT_TOLERANCE_RAD, JointSpace
from cspace.world import ARM_IN_PICTURE, LITTLE_IN_REACH, Finding, World
from cspace_client.wire import Alternative, Contact, LeastSure, PlanAnswer, PlanTimingMs, Trajectory
from inference_api.kernels import Kernels, needs_kernels
from inference_api.limits import ComputePlace
from inference_api.pictures import Prepared, PreparedPictures
from inference_api.request_body import body_of, both_bodies
from inference_api.routes.outcomes import keep_plan, key_name
from inference_api.scene import (
    PlanRequest,
    about,
    answer_responses,
    has_known,
    json_response,
    robot_of,
    served_for,
    view_of,
    warnings_of,
)
from inference_api.served_models import ServedModel
from inference_api.telemetry import PLANS, request_fields
from services.outcomes import problem_of

# Findings by which a plan is refused.
_WHY = (ARM_IN_PICTURE, LITTLE_IN_REACH)

router = APIRouter()


@router.post(
    "/plan",
    summary="Plan a path through a picture's scenario, or explain why there is none",
    openapi_extra=both_bodies(PlanRequest),
    responses=answer_responses(PlanAnswer),
)
def plan(
    request: Annotated[PlanRequest, Depends(body_of(PlanRequest))],
    served: Annotated[ServedModel, Depends(served_for(PlanRequest))],
    place: ComputePlace,
    pictures: PreparedPictures,
    kernels: Kernels,
    http: Request,
) -> Response:
    """Returns, of several paths through what the picture shows, the one with the least cost.

    The search treats unknown space as free; the model estimates how likely it is free.
    """
    began = time.perf_counter()
    kernels.require()
    bundle, spec, view = served.bundle, served.bundle.spec, view_of(request)
    given = _query_of(request)
    query = fitted_plan(spec, given)
    require_robot(robot_of(request), spec)
    if not bundle.has_validity:
        raise InputError("the model has no validity head", remedy="name a model that has one")
    with needs_kernels():
        # Before the pictures: a wrong start costs nothing.
        fitted_problem(spec, given)
        prepared = pictures.prepare(bundle, view, place.check_cancelled, request.check_pose)
        findings = _findings(spec.world, prepared, query)
        if given.min_confidence is None and any(one.code == LITTLE_IN_REACH for one in findings):
            # The calibration of other scenes does not hold here, so that paths are refused by default.
            query = replace(query, min_confidence=1.0)
        found = bundle.plan(prepared.picture, query, place.check_cancelled)
    PLANS.labels(found.status).inc()
    request_fields.get().update(model=str(served), seed=str(query.seed))
    kept, receipts = None, http.app.state.receipts
    receipt = None
    if receipts is not None and found.status == "solved":
        problem = problem_of(view.digest(), found.path[0], found.path[-1])
        receipt = receipts.issue(
            http.state.request_id, served.name, served.version, found.confidence, key_name(http), problem
        )
    if request.keep:
        kept = (
            found.status == "solved"
            and not has_known(request)
            and keep_plan(http, served, view.packed(), found.path)
        )
    return json_response(
        PlanAnswer.model_construct(
            status=found.status,
            reason=_reason(found, query, request.max_risk, findings),
            path=found.path,
            trajectory=None if found.trajectory is None else Trajectory.model_validate(found.trajectory),
            confidence=found.confidence,
            receipt=receipt,
            kept=kept,
            edges=found.edges,
            unseen=found.unseen,
            length_rad=found.length_rad,
            ways=found.found,
            least_sure=None if found.least is None else LeastSure.model_validate(found.least),
            alternatives=[Alternative.model_validate(one) for one in found.alternatives]
            if request.alternatives
            else None,
            contact=None if found.contact is None else Contact.model_validate(found.contact),
            seed=query.seed,
            timing_ms=PlanTimingMs(
                decode=prepared.decode_ms,
                encode=prepared.encode_ms,
                search=found.search_ms,
                score=found.score_ms,
                total=1e3 * (time.perf_counter() - began),
            ),
            **about(served, prepared.picture.novelty, warnings_of(findings)),
        )
    )


def _query_of(request: PlanRequest) -> PlanQuery:
    least = request.min_confidence
    if request.max_risk is not None:
        if least is not None:
            raise InputError("max_risk comes with min_confidence", expected="one of them", got="both")
        least = 1.0 - request.max_risk
    pose, upright = request.goal_pose, request.upright
    velocity, acceleration = request.max_velocity_rad_s, request.max_acceleration_rad_s2
    return PlanQuery(
        start=tuple(request.start),
        goal=None if request.goal is None else tuple(request.goal),
        seed=random_seed(request.seed),
        min_confidence=least,
        time_limit_s=request.time_limit_s,
        ways=request.ways,
        alternatives=request.alternatives,
        explain=request.explain,
        goal_pose=None if pose is None else pose.model_dump(),
        limits=None
        if request.limits is None
        else tuple(None if one is None else (one[0], one[1]) for one in request.limits),
        upright=None if upright is None else upright.model_dump(),
        unwrapped=request.unwrapped,
        goal_free=request.goal_free,
        max_velocity_rad_s=None if velocity is None else tuple(velocity),
        max_acceleration_rad_s2=None if acceleration is None else tuple(acceleration),
    )


def _findings(world: World, prepared: Prepared, query: PlanQuery) -> tuple[Finding, ...]:
    found = prepared.findings
    if prepared.without_state:
        found = prepared.findings_with(world, image=prepared.picture.image, start=query.start)
    return (*found, *_beyond(planning_space(world, query.limits), query.start))


def _beyond(space: JointSpace, start: Sequence[float]) -> list[Finding]:
    """Whether a limited joint starts beyond its range."""
    off = np.maximum(np.subtract(space.lower, start), np.subtract(start, space.upper))
    off = np.where(space.periodic, 0.0, off)
    joint = int(np.argmax(off))
    if off[joint] <= LIMIT_TOLERANCE_RAD:
        return []
    name = space.names[joint] if space.names else f"joint {joint + 1}"
    seen = f"{name} starts {off[joint]:.4f} rad beyond its limit"
    return [
        Finding(
            "start-beyond-limit",
            seen,
            "the first edge of the path leads back to the limit, and is not checked",
            "drive it back slowly, or check the joint's zero",
        )
    ]


def _reason(found: Plan, query: PlanQuery, max_risk: float | None, findings: Sequence[Finding]) -> str | None:
    """What is in the way, by what is most certain, and then how the search ended."""
    if found.status == "solved":
        return None
    causes = [] if found.reason is None else [found.reason]
    causes += [one.message for one in findings if one.code in _WHY]
    if found.least is not None:
        causes.insert(0, _too_risky(found, query, max_risk))
    elif found.status == "timeout":
        causes.append(f"the time ended: no path was found within {query.time_limit_s:g} s")
    elif not causes:
        causes.append("start and goal seem to lie in separate parts of what the picture shows as free")
    if found.contact is not None and not any(found.contact.text in one for one in causes):
        crossing = found.least is None and found.reason is None
        causes.append(f"the shallowest crossing: {found.contact.text}" if crossing else found.contact.text)
    return "; ".join(causes)


def _too_risky(found: Plan, query: PlanQuery, max_risk: float | None) -> str:
    least = found.least
    if max_risk is None:
        said = f"the best of {found.found} paths has a confidence of {found.confidence:.3f}"
        said += f", below the requested {query.min_confidence:g}"
    else:
        said = f"the least risk found is {1.0 - found.confidence:.3f}; {max_risk:g} was allowed"
    if least is None:
        return said
    unseen = "" if least.unseen is None else f", where {least.unseen:.0%} of the robot is in unseen space"
    return (
        f"{said}; its lowest confidence is {least.confidence:.3f} at {least.along:.0%} of its length{unseen}"
    )
