"""A way from start to goal, from field values to the bytes of the answer; runs in a worker thread."""

import time
from collections.abc import Sequence
from dataclasses import dataclass, replace

from fastapi.responses import Response

from cspace.bundle import BundleSpec
from cspace.bundle.request import fitted_end, fitted_plan, require_robot
from cspace.errors import InputError
from cspace.query import Doubt, Plan, PlanQuery
from cspace.world import ARM_IN_PICTURE, LITTLE_IN_REACH, Finding
from inference_api.bodies.request_body import PLAN_FORM, RawFields, parse_fields
from inference_api.models.pictures import Prepared
from inference_api.models.served import ServedModel
from inference_api.models.store import ModelStore
from inference_api.pages.model_schemas import joint_space_info
from inference_api.pages.planning.schemas import (
    Alternative,
    LeastSure,
    NextViewInfo,
    PlanAnswer,
    PlanRequest,
    PlanTimingMs,
)
from inference_api.pages.sampling import model_info, prepared_picture
from inference_api.pages.schemas import ScenarioInfo, warnings_of
from inference_api.pages.validation import validate_fields
from inference_api.telemetry.observer import Planned
from inference_api.turns.costs import rows_of
from inference_api.turns.searching import searching
from inference_api.turns.turns import Turn
from services.registry.references import ModelReference

# Findings by which a plan is refused.
_WHY = (ARM_IN_PICTURE, LITTLE_IN_REACH)


@dataclass(frozen=True, slots=True, eq=False)
class PlanQuestion:
    """A valid request; an :class:`~inference_api.pages.exchange.Question`.

    Args:
        store: where pictures are known and observers told.
        reference: the model that it names.
        image: the picture's file.
        query: start and goal, not held against the model's robot yet, and limits.
        robot: whose they are; None for the model's.
        began: ``time.perf_counter()`` when the request came in, s.
    """

    store: ModelStore
    reference: ModelReference
    image: bytes
    query: PlanQuery
    robot: str | None
    began: float

    def answer(self, served: ServedModel, turn: Turn) -> Response:
        """Plan and write.

        Raises:
            CspaceError: as the contract's table of errors.
            ClientDisconnect: the client has gone away.
        """
        self.store.planner.require()
        bundle, spec = served.bundle, served.bundle.spec
        query = fitted_plan(spec, self.query)
        require_robot(self.robot, spec)
        if not bundle.has_validity:
            raise InputError("the model has no validity head", remedy="name a model that has one")
        for name, end in (("start", self.query.start), ("goal", self.query.goal)):
            fitted_end(spec, name, end)
        with searching(turn) as between:
            prepared = prepared_picture(self.store, bundle, self.image, turn)
            warnings = self._warnings(spec, prepared)
            if self.query.min_confidence is None and any(one.code == LITTLE_IN_REACH for one in warnings):
                # By what other scenes were like no path is sure enough, unless somebody asks for less.
                query = replace(query, min_confidence=1.0)
            found = bundle.plan(prepared.picture, query, between)
        self.store.observer.planned(
            Planned(f"{served.name}/{served.version}", served.fallback, found.status, self.query.seed)
        )
        return self._response(served, prepared, found, query, warnings)

    def _warnings(self, spec: BundleSpec, prepared: Prepared) -> tuple[Finding, ...]:
        if not prepared.without_state:
            return prepared.findings
        image = spec.world.sensor.from_network(prepared.picture.pixels)[0]
        return prepared.findings_with(spec.world, image=image, start=self.query.start)

    def _response(
        self,
        served: ServedModel,
        prepared: Prepared,
        found: Plan,
        query: PlanQuery,
        warnings: tuple[Finding, ...],
    ) -> Response:
        view = found.next_view
        body = PlanAnswer.model_construct(
            status=found.status,
            reason=_reason(found, query, warnings),
            path=found.way.tolist(),
            confidence=found.confidence,
            edges=found.edges.tolist(),
            unseen=None if found.unseen is None else found.unseen.tolist(),
            length_rad=found.length_rad,
            ways=found.found,
            least_sure=_told(found.least),
            alternatives=_alternatives(found) if self.query.alternatives else None,
            next_view=None if view is None else NextViewInfo(camera=dict(view.camera), sees=view.sees),
            seed=str(self.query.seed),
            scenario=ScenarioInfo(novelty=prepared.picture.novelty),
            warnings=warnings_of(warnings),
            joint_space=joint_space_info(served.bundle.spec.joint_space),
            model=model_info(served),
            timing_ms=PlanTimingMs(
                decode=prepared.decode_ms,
                encode=prepared.encode_ms,
                search=found.search_ms,
                score=found.score_ms,
                total=1e3 * (time.perf_counter() - self.began),
            ),
        )
        return Response(body.model_dump_json(), media_type="application/json")


def read_plan(store: ModelStore, fields: RawFields, turn: Turn, *, began: float) -> PlanQuestion:
    """Parse and validate.

    Args:
        store: where the models are.
        fields: the body as it was read.
        turn: told what reading costs.
        began: as :class:`PlanQuestion` has it.

    Raises:
        CspaceError: as the contract's table of errors.
    """
    turn.spend(rows_of(json_bytes=fields.json_bytes))
    request = validate_fields(PlanRequest, parse_fields(fields, PLAN_FORM))
    named = request.model if "model" in request.model_fields_set else store.model_name
    query = PlanQuery(
        request.start,
        request.goal,
        request.drawn_seed(),
        request.min_confidence,
        request.time_limit_s,
        request.ways,
        request.next_view or bool(request.view),
        request.view,
        request.alternatives,
        request.camera,
    )
    reference = ModelReference.parse(named)
    return PlanQuestion(store, reference, request.picture(), query, request.robot, began)


def _alternatives(found: Plan) -> list[Alternative]:
    return [
        Alternative(path=one.way.tolist(), confidence=one.confidence, edges=one.edges.tolist())
        for one in found.alternatives
    ]


def _told(least: Doubt | None) -> LeastSure | None:
    if least is None:
        return None
    return LeastSure(
        configuration=least.configuration.tolist(),
        confidence=least.confidence,
        unseen=least.unseen,
        along=least.along,
    )


def _reason(found: Plan, query: PlanQuery, warnings: Sequence[Finding]) -> str | None:
    if found.status == "solved":
        return None
    told = "".join(f"; {one.message}" for one in warnings if one.code in _WHY)
    return f"{_why(found, query)}{told}"


def _why(found: Plan, query: PlanQuery) -> str:
    if found.status == "timeout":
        return f"no way was found within {query.time_limit_s:g} s"
    least = found.least
    if least is None:
        return "no way was found through what the picture shows"
    unseen = "" if least.unseen is None else f", where {least.unseen:.0%} of the robot is in unseen space"
    return (
        f"the surest of {found.found} ways has a confidence of {found.confidence:.3f}, asked for is "
        f"{query.min_confidence:g}; it is least sure at {least.along:.0%} of its length, with "
        f"{least.confidence:.3f}{unseen}"
    )
