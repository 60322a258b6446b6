"""``POST /plan`` as clients ask it."""

import json
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from cspace_client.answer_errors import printable, unusable
from cspace_client.joint_space import JointSpace
from cspace_client.model import ModelHead
from cspace_client.plans import BelievedWay, Doubt, FoundPlan, NextView, Plan, PlanWanted, Status
from cspace_client.questions.model_head import read_media_type, require_asked, space_of, warnings_of
from cspace_client.questions.question import Question
from cspace_client.samples import configuration, is_digest
from cspace_client.strict_json import Members, parse_json

JSON = "application/json"
# Of a way with thousands of corners.
_MAX_BYTES = 4 * 1024 * 1024
_MAX_NAME = 256
# Start and goal come back as circles are written: within a turn, in the numbers that were sent.
_SAME_RAD = 1e-6
_STATUSES: tuple[Status, ...] = ("solved", "refused", "timeout")


@dataclass(frozen=True, slots=True, eq=False)
class PlanQuestion(Question[FoundPlan]):
    """A request for a way.

    Args:
        query: what is asked.
    """

    path: ClassVar[str] = "/plan"
    media_type: ClassVar[str] = JSON

    query: PlanWanted

    def own_fields(self) -> dict[str, Any]:
        """All of the query; of what older servers do not know, what is not taken for granted."""
        query = self.query
        flags = {"next_view": query.next_view, "alternatives": query.alternatives}
        fields: dict[str, Any] = {name: "true" for name, wanted in flags.items() if wanted}
        if query.views:
            fields["view"] = [json.dumps(dict(view)) for view in query.views]
        if query.time_limit_s is not None:
            fields["time_limit_s"] = repr(float(query.time_limit_s))
        if query.ways is not None:
            fields["ways"] = str(query.ways)
        if query.min_confidence is not None:
            fields["min_confidence"] = repr(float(query.min_confidence))
        return fields | {
            "start": json.dumps(configuration("start", query.start)),
            "goal": json.dumps(configuration("goal", query.goal)),
            "seed": str(query.seed),
        }

    def read(self, headers: Mapping[str, str]) -> "PlanReading":
        """See :class:`cspace_client.questions.question.Question`."""
        read_media_type(headers, JSON)
        return PlanReading(self)


@dataclass(frozen=True, slots=True, eq=False)
class PlanReading:
    """See :class:`cspace_client.questions.question.Reading`."""

    question: PlanQuestion

    @property
    def limit_bytes(self) -> int:
        """Of JSON."""
        return _MAX_BYTES

    def conclude(self, body: bytes, round_trip_s: float) -> FoundPlan:
        """The plan, whose way leads from start to goal within the joints' limits."""
        try:
            told = Members(parse_json(body), "plan")
        except ValueError as error:
            raise unusable("is no plan", "the members of a plan", str(error)) from error
        query, seed = self.question.query, told.seed("seed")
        if seed != query.seed:
            raise unusable("is for another seed", str(query.seed), str(seed))
        head = self._head(told.inner("model"))
        space = space_of(told.plain("joint_space"), f"joint_space: {str(told.plain('joint_space'))[:80]}")
        scenario = told.inner("scenario")
        novelty = scenario.number("novelty", 1.0) if scenario.told("novelty") else None
        plan = _plan(told, space)
        _require_fit(plan, query, space)
        reason = printable(told.text("reason")) if told.told("reason") else None
        warnings = warnings_of(told) if told.has("warnings") else ()
        head = replace(head, space=space, novelty=novelty, warnings=warnings)
        return FoundPlan(plan, reason, seed, head, round_trip_s)

    def _head(self, model: Members) -> ModelHead:
        name, version, robot = model.text("name", _MAX_NAME), model.count("version"), model.text("robot")
        digest = model.text("digest")
        for what, value in (("digest", digest), ("robot", robot)):
            if not is_digest(value):
                raise unusable(f"names a wrong {what}", "a SHA-256 in hexadecimal", repr(value[:80]))
        require_asked(self.question.model, self.question.robot, name, version, robot)
        confirmed = model.flag("alias_confirmed")
        return ModelHead(printable(name), version, digest, robot=robot, alias_confirmed=confirmed)


def _plan(told: Members, space: JointSpace) -> Plan:
    least = told.inner("least_sure") if told.told("least_sure") else None
    view = told.inner("next_view") if told.has("next_view") else None
    timing = told.inner("timing_ms")
    return Plan(
        status=told.one_of("status", _STATUSES),
        way=_way(told, space),
        confidence=told.number("confidence", 1.0),
        edges=np.array(told.shares("edges"), dtype=np.float32),
        unseen=np.array(told.shares("unseen"), dtype=np.float32) if told.told("unseen") else None,
        length_rad=told.number("length_rad"),
        found=told.count("ways"),
        least=None if least is None else _doubt(least, space),
        next_view=None if view is None else NextView(view.plain("camera"), view.number("sees", 1.0)),
        alternatives=tuple(
            BelievedWay(
                _way(one, space),
                one.number("confidence", 1.0),
                np.array(one.shares("edges"), dtype=np.float32),
            )
            for one in (told.each("alternatives") if told.has("alternatives") else ())
        ),
        search_ms=timing.number("search"),
        score_ms=timing.number("score"),
    )


def _doubt(least: Members, space: JointSpace) -> Doubt:
    unseen = least.number("unseen", 1.0) if least.told("unseen") else None
    row = _rows([least.row("configuration")], space)[0]
    return Doubt(row, least.number("confidence", 1.0), unseen, least.number("along", 1.0))


def _way(told: Members, space: JointSpace) -> NDArray[np.float64]:
    return _rows(told.rows("path"), space)


def _rows(rows: list[list[float]], space: JointSpace) -> NDArray[np.float64]:
    if any(len(row) != space.dim for row in rows):
        raise unusable("has no whole way", f"corners of {space.dim} joints", "others")
    return np.array(rows, dtype=np.float64).reshape(len(rows), space.dim)


def _require_fit(plan: Plan, query: PlanWanted, space: JointSpace) -> None:
    """Refuse a way that is none, that leads elsewhere, or that is less sure than was asked for.

    Raises:
        SamplerAnswerError: it is such a one.
    """
    for way in plan.alternatives:
        _require_way(way, query, space)
    unseen = () if plan.unseen is None else plan.unseen
    if plan.status == "solved":
        if plan.unseen is not None and len(unseen) != len(plan.edges):
            raise unusable("has no whole way", f"{len(plan.edges)} unseen shares", str(len(unseen)))
        _require_way(plan, query, space)
    elif any(map(len, (plan.way, plan.edges, unseen, plan.alternatives))):
        raise unusable("has a way that was not found", "none", plan.status)


def _require_way(way: Plan | BelievedWay, query: PlanWanted, space: JointSpace) -> None:
    pieces = len(way.way) - 1
    if pieces < 1 or len(way.edges) != pieces:
        raise unusable("has no whole way", "two corners or more, edges between", f"{pieces} edges")
    if query.min_confidence is not None and way.confidence < query.min_confidence:
        raise unusable("is less sure than was asked for", str(query.min_confidence), str(way.confidence))
    if not space.holds(way.way).all():
        ends = f"from {space.lower} to {space.upper}"
        raise unusable("leaves the joints' limits", ends[:200], "others")
    ends_rad = [np.asarray(end, dtype=np.float64) for end in (query.start, query.goal)]
    if (
        any(end.shape != (space.dim,) for end in ends_rad)
        or (space.distance(ends_rad, way.way[[0, -1]]) > _SAME_RAD).any()
    ):
        raise unusable("leads elsewhere", "a way from start to goal", "other ends")
