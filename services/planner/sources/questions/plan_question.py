"""``POST /plan`` as clients ask it."""

import json
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Annotated, Any, ClassVar, Literal

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, ValidationError

from cspace.planning.query import BelievedWay, Doubt, Plan, PlanQuery
from cspace.query import is_digest
from cspace.space import JointSpace
from cspace.world import NextView
from services.planner.sources.answer_errors import printable, unusable
from services.planner.sources.questions.model_head import (
    ModelHead,
    read_media_type,
    require_asked,
    space_of,
)
from services.planner.sources.questions.npy_body import MAX_JOINTS
from services.planner.sources.questions.question import Question

JSON = "application/json"
# Of a way with thousands of corners.
_MAX_BYTES = 4 * 1024 * 1024
# Start and goal come back as circles are written: within a turn, in the numbers that were sent.
_SAME_RAD = 1e-6


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
    model: ModelHead
    round_trip_s: float


@dataclass(frozen=True, slots=True, eq=False)
class PlanQuestion(Question[FoundPlan]):
    """A request for a way.

    Args:
        query: what is asked.
    """

    path: ClassVar[str] = "/plan"
    media_type: ClassVar[str] = JSON

    query: PlanQuery

    def own_fields(self) -> dict[str, Any]:
        """All of the query; of what older servers do not know, what is not taken for granted."""
        query = self.query
        flags = {"next_view": query.next_view, "alternatives": query.alternatives}
        fields: dict[str, Any] = {name: "true" for name, wanted in flags.items() if wanted}
        if query.views:
            fields["view"] = [json.dumps(dict(view)) for view in query.views]
        return fields | {
            "start": json.dumps(query.start),
            "goal": json.dumps(query.goal),
            "seed": str(query.seed),
            "min_confidence": repr(query.min_confidence),
            "time_limit_s": repr(query.time_limit_s),
            "ways": str(query.ways),
        }

    def read(self, headers: Mapping[str, str]) -> "PlanReading":
        """See :class:`services.planner.sources.questions.question.Question`."""
        read_media_type(headers, JSON)
        return PlanReading(self)


_Share = Annotated[float, Field(ge=0.0, le=1.0)]
_Row = Annotated[list[float], Field(max_length=MAX_JOINTS)]
_Length = Annotated[float, Field(ge=0.0)]


class _Told(BaseModel):
    """What is read of an answer; what a later release says beside it is not."""

    model_config = ConfigDict(strict=True, extra="ignore", allow_inf_nan=False)


class _Model(_Told):
    name: Annotated[str, Field(min_length=1, max_length=256)]
    version: Annotated[int, Field(ge=0)]
    digest: str
    robot: str
    alias_confirmed: bool


class _Least(_Told):
    configuration: _Row
    confidence: _Share
    unseen: _Share | None
    along: _Share


class _Way(_Told):
    path: list[_Row]
    confidence: _Share
    edges: list[_Share]


class _View(_Told):
    camera: dict[str, Any]
    sees: _Share


class _Timing(_Told):
    search: _Length
    score: _Length


class _Scenario(_Told):
    novelty: _Share | None


class _Answer(_Told):
    status: Literal["solved", "refused", "timeout"]
    reason: str | None
    path: list[_Row]
    confidence: _Share
    edges: list[_Share]
    unseen: list[_Share] | None
    length_rad: _Length
    ways: Annotated[int, Field(ge=0)]
    least_sure: _Least | None
    next_view: _View | None = None
    alternatives: list[_Way] | None = None
    seed: int
    scenario: _Scenario
    joint_space: dict[str, Any]
    model: _Model
    timing_ms: _Timing


@dataclass(frozen=True, slots=True, eq=False)
class PlanReading:
    """See :class:`services.planner.sources.questions.question.Reading`."""

    question: PlanQuestion

    @property
    def limit_bytes(self) -> int:
        """Of JSON."""
        return _MAX_BYTES

    def conclude(self, body: bytes, round_trip_s: float) -> FoundPlan:
        """The plan, whose way leads from start to goal within the joints' limits."""
        try:
            told = _Answer.model_validate_json(body)
        except ValidationError as error:
            first = error.errors(include_url=False, include_input=False)[0]
            where = ".".join(map(str, first["loc"])) or "the document"
            raise unusable("is no plan", "the members of a plan", f"{where}: {first['msg']}") from error
        query, model = self.question.query, told.model
        if told.seed != query.seed:
            raise unusable("is for another seed", str(query.seed), str(told.seed))
        for name, value in (("digest", model.digest), ("robot", model.robot)):
            if not is_digest(value):
                raise unusable(f"names a wrong {name}", "a SHA-256 in hexadecimal", repr(value[:80]))
        require_asked(self.question.model, self.question.robot, model.name, model.version, model.robot)
        space = space_of(told.joint_space, f"joint_space: {str(told.joint_space)[:80]}")
        _require_fit(told, query, space)
        head = ModelHead(
            model_name=printable(model.name),
            model_version=model.version,
            digest=model.digest,
            novelty=told.scenario.novelty,
            space=space,
            robot=model.robot,
            alias_confirmed=model.alias_confirmed,
        )
        reason = None if told.reason is None else printable(told.reason)
        return FoundPlan(_plan(told, space), reason, told.seed, head, round_trip_s)


def _plan(told: _Answer, space: JointSpace) -> Plan:
    least = told.least_sure
    return Plan(
        status=told.status,
        way=np.array(told.path, dtype=np.float64).reshape(len(told.path), space.dim),
        confidence=told.confidence,
        edges=np.array(told.edges, dtype=np.float32),
        unseen=None if told.unseen is None else np.array(told.unseen, dtype=np.float32),
        length_rad=told.length_rad,
        found=told.ways,
        least=None
        if least is None
        else Doubt(np.array(least.configuration), least.confidence, least.unseen, least.along),
        next_view=None if told.next_view is None else NextView(told.next_view.camera, told.next_view.sees),
        alternatives=tuple(
            BelievedWay(np.array(one.path), one.confidence, np.array(one.edges, dtype=np.float32))
            for one in told.alternatives or ()
        ),
        search_ms=told.timing_ms.search,
        score_ms=told.timing_ms.score,
    )


def _require_fit(told: _Answer, query: PlanQuery, space: JointSpace) -> None:
    """Refuse a way that is none, that leads elsewhere, or that is less sure than was asked for.

    Raises:
        SamplerAnswerError: it is such a one.
    """
    for way in told.alternatives or ():
        _require_way(way, query, space)
    if told.status == "solved":
        if told.unseen is not None and len(told.unseen) != len(told.edges):
            raise unusable("has no whole way", f"{len(told.edges)} unseen shares", str(len(told.unseen)))
        _require_way(_Way.model_construct(**told.model_dump(include=set(_Way.model_fields))), query, space)
    elif told.path or told.edges or told.unseen or told.alternatives:
        raise unusable("has a way that was not found", "none", told.status)


def _require_way(way: _Way, query: PlanQuery, space: JointSpace) -> None:
    pieces = len(way.path) - 1
    if pieces < 1 or len(way.edges) != pieces or {len(row) for row in way.path} != {space.dim}:
        raise unusable("has no whole way", f"corners of {space.dim} joints, edges between", f"{pieces} edges")
    if way.confidence < (query.min_confidence or 0.0):
        raise unusable("is less sure than was asked for", str(query.min_confidence), str(way.confidence))
    rows = np.array(way.path)
    if not space.holds(rows).all():
        raise unusable("leaves the joints' limits", str(space.to_dict())[:200], "others")
    ends = np.array([query.start, query.goal], dtype=np.float64)
    if ends.shape[1] != space.dim or (space.distance(ends, rows[[0, -1]]) > _SAME_RAD).any():
        raise unusable("leads elsewhere", "a way from start to goal", "other ends")
