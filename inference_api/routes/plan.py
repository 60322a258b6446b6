"""``POST /plan``: a path from start to goal that the model predicts to be free, or why there is none."""

import time
from collections.abc import Sequence
from dataclasses import replace
from functools import partial

import numpy as np
from fastapi import APIRouter, Request
from fastapi.responses import Response
from numpy.typing import NDArray

from cspace.bundle import BundleSpec
from cspace.bundle.samples import fitted_plan, fitted_problem, require_robot
from cspace.errors import InputError
from cspace.query import Plan, PlanQuery, random_seed
from cspace.world import ARM_IN_PICTURE, LITTLE_IN_REACH, Finding
from inference_api.logs import request_record
from inference_api.models.pictures import Prepared
from inference_api.models.served import ServedModel
from inference_api.problem_types import NO_PLANNER, SAMPLE_PROBLEMS, STARTING
from inference_api.requests import Service, Serving, both_bodies, problem_responses
from inference_api.routes.sample import answer_responses, prepared_picture
from inference_api.scheduler import Job
from inference_api.schemas import (
    Alternative,
    ContactInfo,
    LeastSure,
    NextViewInfo,
    PlanAnswer,
    PlanRequest,
    PlanTimingMs,
    about,
    warnings_of,
)
from inference_api.telemetry import Answered
from services.outcomes import problem_of, view_row

# Findings by which a plan is refused.
_WHY = (ARM_IN_PICTURE, LITTLE_IN_REACH)

router = APIRouter()


@router.post(
    "/plan",
    summary="Plan a path through a picture's scenario, or explain why there is none",
    openapi_extra=both_bodies(PlanRequest),
    responses=answer_responses(PlanAnswer) | problem_responses(*SAMPLE_PROBLEMS, NO_PLANNER, STARTING),
)
async def plan(request: Request, service: Serving) -> Response:
    """Returns, of several paths through what the picture shows, the one with the least cost.

    The search treats unknown space as free; the model estimates how likely it is free.
    """
    work = partial(_answer, service, began=time.perf_counter())
    return await service.answer(request, PlanRequest, work)


def _answer(
    service: Service,
    request: PlanRequest,
    served: ServedModel,
    job: Job,
    *,
    began: float,
) -> Response:
    store = service.store
    store.planner.require()
    bundle, spec, image = served.bundle, served.bundle.spec, request.picture()
    given = query_of(request)
    query = fitted_plan(spec, given)
    require_robot(request.robot, spec)
    if not bundle.has_validity:
        raise InputError("the model has no validity head", remedy="name a model that has one")
    fitted_problem(spec, given)
    with job.searching() as check_cancelled:
        prepared = prepared_picture(store, bundle, image, job)
        warnings = _warnings(spec, prepared, request.start)
        if given.min_confidence is None and any(one.code == LITTLE_IN_REACH for one in warnings):
            # The calibration of other scenes does not hold here, so that paths are refused by default.
            query = replace(query, min_confidence=1.0)
        found = bundle.plan(prepared.picture, query, check_cancelled)
    service.metrics.answered(Answered("plan", served, status=found.status, seed=query.seed))
    record, receipt, kept = request_record.get(), None, None
    if record is not None and service.receipts is not None and found.status == "solved":
        problem = problem_of(image, found.path[0], found.path[-1])
        receipt = service.receipts.issue(
            record.request_id, served.name, served.version, found.confidence, record.client, problem
        )
    if request.keep:
        kept = (
            found.status == "solved" and not request.has_known and _keep(service, served, image, found.path)
        )
    least, view = found.least, found.next_view
    body = PlanAnswer.model_construct(
        status=found.status,
        reason=_reason(found, query, warnings),
        path=found.path.tolist(),
        confidence=found.confidence,
        receipt=receipt,
        kept=kept,
        edges=found.edges.tolist(),
        unseen=None if found.unseen is None else found.unseen.tolist(),
        length_rad=found.length_rad,
        ways=found.found,
        least_sure=None
        if least is None
        else LeastSure(
            configuration=least.configuration.tolist(),
            confidence=least.confidence,
            unseen=least.unseen,
            along=least.along,
        ),
        alternatives=[
            Alternative(path=one.path.tolist(), confidence=one.confidence, edges=one.edges.tolist())
            for one in found.alternatives
        ]
        if request.alternatives
        else None,
        contact=ContactInfo.of(found.contact),
        next_view=None if view is None else NextViewInfo.model_validate(view, from_attributes=True),
        seed=str(query.seed),
        timing_ms=PlanTimingMs(
            decode=prepared.decode_ms,
            encode=prepared.encode_ms,
            search=found.search_ms,
            score=found.score_ms,
            total=1e3 * (time.perf_counter() - began),
        ),
        **about(served, prepared.picture.novelty, warnings_of(warnings)),
    )
    return Response(body.model_dump_json(), media_type="application/json")


def _keep(service: Service, served: ServedModel, image: bytes, path: NDArray[np.float64]) -> bool:
    """Whether pictures and path are taken for the upload of outcomes."""
    record = request_record.get()
    if record is None or service.spool is None or not service.keep_s:
        return False
    asked = {"request_id": record.request_id, "client": record.client, "received_s": round(time.time(), 3)}
    row = view_row(served, served.bundle.robot, image, path, service.keep_s)
    return service.spool.add([asked | row])


def query_of(request: PlanRequest) -> PlanQuery:
    """The planner's query of a request.

    Raises:
        InputError: it has both ``min_confidence`` and ``max_risk``.
    """
    least = request.min_confidence
    if request.max_risk is not None:
        if least is not None:
            raise InputError("max_risk comes with min_confidence", expected="one of them", got="both")
        least = 1.0 - request.max_risk
    return PlanQuery(
        request.start,
        request.goal,
        random_seed(request.seed),
        least,
        request.time_limit_s,
        request.ways,
        request.next_view or bool(request.view),
        request.view,
        request.alternatives,
        request.camera,
        request.state,
        request.explain,
        request.goal_pose,
        request.limits,
        request.upright,
        request.unwrapped,
    )


def _warnings(spec: BundleSpec, prepared: Prepared, start: tuple[float, ...]) -> tuple[Finding, ...]:
    if not prepared.without_state:
        return prepared.findings
    image = prepared.picture.image
    return prepared.findings_with(spec.world, image=image, start=start)


def _reason(found: Plan, query: PlanQuery, warnings: Sequence[Finding]) -> str | None:
    if found.status == "solved":
        return None
    notes = "".join(f"; {one.message}" for one in warnings if one.code in _WHY)
    touches = "" if found.contact is None else f"; {found.contact.text}"
    return f"{_why(found, query)}{touches}{notes}"


def _why(found: Plan, query: PlanQuery) -> str:
    if found.reason is not None:
        return found.reason
    if found.status == "timeout":
        return f"no path was found within {query.time_limit_s:g} s"
    least = found.least
    if least is None:
        return "no path was found through what the picture shows"
    unseen = "" if least.unseen is None else f", where {least.unseen:.0%} of the robot is in unknown space"
    return (
        f"the best of {found.found} paths has a confidence of {found.confidence:.3f}, below the requested "
        f"{query.min_confidence:g}; its lowest confidence is {least.confidence:.3f} at {least.along:.0%} of "
        f"its length{unseen}"
    )
