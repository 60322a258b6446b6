"""The requests of an inference API, one class for each endpoint, and how their answers are read."""

import base64
import io
import json
import math
from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass, fields, replace
from typing import Annotated, Any, ClassVar, Generic, TypeVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from cspace_client.answers import (
    MAX_HEAD_BYTES,
    MAX_JOINTS,
    NPY,
    max_body_bytes,
    parse_object,
    read_headers,
    read_object,
    read_request_id,
    read_rows,
    read_samples,
    read_timing,
    require_requested,
)
from cspace_client.errors import SamplerError, unusable
from cspace_client.known import as_json
from cspace_client.models import (
    MAX_SAMPLES,
    PLAIN,
    AlternativePath,
    Belief,
    Diagnosis,
    FoundPlan,
    JointSpace,
    ModelHead,
    Plan,
    PlanQuery,
    SampleBatch,
    SampleQuery,
    Wire,
    configuration,
)
from cspace_client.pictures import File, Shown

Found = TypeVar("Found")

JSON = "application/json"
# Of a path with thousands of corners.
_MAX_JSON_BYTES = 4 * 1024 * 1024


@dataclass(frozen=True, slots=True)
class Answer:
    """An answer of status 200.

    Args:
        headers: names in any case if the mapping does not mind it.
        body: whole.
        round_trip_s: how long it took.
    """

    headers: Mapping[str, str]
    body: bytes
    round_trip_s: float


@dataclass(frozen=True, slots=True, eq=False)
class Question(ABC, Generic[Found]):
    """One request, which may be sent more than once: its seed makes every answer to it the same.

    Args:
        shown: the picture, as it is sent.
        model: ``name``, ``name@alias``, ``name/version`` or ``pretrained``; None for the default.
        robot: that is planned for; None for any.
    """

    path: ClassVar[str]
    media_type: ClassVar[str] = JSON

    shown: Shown
    model: str | None
    robot: str | None

    @property
    def limit_bytes(self) -> int:
        """The longest body of an answer that can be right."""
        return _MAX_JSON_BYTES

    @property
    def fields(self) -> dict[str, Any]:
        """The form's fields; what the endpoint takes for granted is left to it."""
        named = {"robot": self.robot, "model": self.model}
        given = {name: value for name, value in named.items() if value is not None}
        return {**self.shown.fields, **self.own_fields(), **given}

    @property
    def files(self) -> list[tuple[str, File]]:
        """The form's files, each with its field."""
        pictures = [("image", file) for file in self.shown.files]
        return [*pictures, *(("mesh", file) for file in self.shown.meshes), *self.own_files()]

    def own_fields(self) -> dict[str, Any]:
        """Those that this question has beside the pictures."""
        return {}

    def own_files(self) -> list[tuple[str, File]]:
        """Files beside the picture, each with its field."""
        return []

    @abstractmethod
    def read(self, answer: Answer) -> Found:
        """What an answer stands for.

        Raises:
            SamplerAnswerError: it can not be used, or answers another question.
        """

    def model_of(self, members: Mapping[str, Any], what: str) -> ModelHead:
        """The model that an answer in JSON is of.

        Raises:
            SamplerAnswerError: it is another than was asked for.
        """
        head = read_object(ModelHead, members, what)
        require_requested(self.model, self.robot, head)
        return head


@dataclass(frozen=True, slots=True, eq=False)
class SampleQuestion(Question[SampleBatch]):
    """A request for samples.

    Args:
        query: what is asked; its robot is the question's.
    """

    path: ClassVar[str] = "/sample"
    media_type: ClassVar[str] = NPY

    query: SampleQuery

    @property
    def limit_bytes(self) -> int:
        """Of so many samples; a server refuses more than it may be asked for."""
        return max_body_bytes(min(self.query.n, MAX_SAMPLES))

    def own_fields(self) -> dict[str, Any]:
        """What the endpoint takes for granted is left to it."""
        query = self.query
        form: dict[str, Any] = {"n": str(query.n), "seed": str(query.seed)}
        if query.epsilon_sigma != PLAIN:
            form["epsilon_sigma"] = [repr(value) for value in query.epsilon_sigma]
        for name in ("start", "goal", "min_confidence"):
            if (value := getattr(query, name)) is not None:
                form[name] = json.dumps(value)
        return form

    def read(self, answer: Answer) -> SampleBatch:
        """See :class:`cspace_client.requests.Question`."""
        query, found = self.query, read_headers(SampleBatch, answer.headers)
        if found["seed"] != query.seed:
            raise unusable("is for another seed", str(query.seed), str(found["seed"]))
        if found["shortfall"] > query.n:
            raise unusable("lacks more samples than requested", f"at most {query.n}", str(found["shortfall"]))
        batch = SampleBatch(
            samples=read_samples(answer.body, query.n - found["shortfall"], found.get("space")),
            round_trip_s=answer.round_trip_s,
            timing=read_timing(answer.headers.get("server-timing", "")),
            request_id=read_request_id(answer.headers),
            **found,
        )
        require_requested(self.model, self.robot, batch)
        return batch


@dataclass(frozen=True, slots=True, eq=False)
class Predictions:
    """What a model holds of configurations.

    Args:
        confidence: (n,) float32, probability that each is free.
        unseen: (n,) float32, share of the robot that no picture shows; None in worlds that are seen whole.
        threshold: the confidence that training recommends to ask for; None without one.
        model: that answered.
        round_trip_s: from the request to the checked answer, further attempts included.
    """

    confidence: NDArray[np.float32]
    unseen: NDArray[np.float32] | None
    threshold: Annotated[float | None, Wire(header="x-threshold", most=1.0)]
    model: ModelHead
    round_trip_s: float


@dataclass(frozen=True, slots=True, eq=False)
class ValidityQuestion(Question[Predictions]):
    """A request for what a model holds of configurations.

    Args:
        configurations: (n, d) float64 rad; see :func:`rows_of`.
    """

    path: ClassVar[str] = "/validity"
    media_type: ClassVar[str] = NPY

    configurations: NDArray[np.float64]

    @property
    def limit_bytes(self) -> int:
        """Two columns of float32."""
        return MAX_HEAD_BYTES + 8 * len(self.configurations)

    def own_files(self) -> list[tuple[str, File]]:
        """As a ``.npy``, which is shorter than JSON and exact."""
        file = io.BytesIO()
        np.save(file, np.ascontiguousarray(self.configurations, dtype="<f8"), allow_pickle=False)
        return [("configurations", ("configurations.npy", file.getvalue(), NPY))]

    def read(self, answer: Answer) -> Predictions:
        """The predictions: shares from 0 to 1, where a second column is that or nowhere a number."""
        columns, rows = read_rows(answer.body, "predictions"), len(self.configurations)
        if columns.shape != (rows, 2):
            raise unusable("holds another array", f"({rows}, 2)", str(columns.shape))
        confidence, unseen = columns[:, 0].copy(), columns[:, 1].copy()
        nowhere = bool(np.isnan(unseen).all())
        known = confidence if nowhere else columns
        # What is not a number is neither.
        if not ((known >= 0.0) & (known <= 1.0)).all():
            raise unusable("holds values that are no shares", "0 to 1", "others")
        head = ModelHead(**read_headers(ModelHead, answer.headers))
        require_requested(self.model, self.robot, head)
        return Predictions(
            confidence=confidence,
            unseen=None if nowhere else unseen,
            model=head,
            round_trip_s=answer.round_trip_s,
            **read_headers(Predictions, answer.headers),
        )


def rows_of(configurations: ArrayLike) -> NDArray[np.float64]:
    """Configurations as a request can hold them, (n, d) float64.

    Raises:
        SamplerError: they are not 1 to ``MAX_SAMPLES`` rows of finite angles.
    """
    rows = np.asarray(configurations, dtype=np.float64)
    fits = rows.ndim == 2 and 1 <= len(rows) <= MAX_SAMPLES and 1 <= rows.shape[1] <= MAX_JOINTS
    if not fits or not np.isfinite(rows).all():
        raise SamplerError(
            "the configurations cannot be sent",
            expected=f"1 to {MAX_SAMPLES} rows of finite angles in rad",
            got=f"shape {rows.shape}" if not fits else "values that are not finite",
        )
    return rows


# Start and goal come back as circles are written: within a turn, in the numbers that were sent.
_SAME_RAD = 1e-6


@dataclass(frozen=True, slots=True, eq=False)
class PlanQuestion(Question[FoundPlan]):
    """A request for a path.

    Args:
        query: what is asked.
    """

    path: ClassVar[str] = "/plan"

    query: PlanQuery

    def own_fields(self) -> dict[str, Any]:
        """Those of the query but what is taken for granted, in JSON but for texts."""
        values = {one.name: getattr(self.query, one.name) for one in fields(self.query)}
        values = {name: value for name, value in values.items() if value is not None and value is not False}
        for end in ("start", "goal"):
            if end in values:
                values[end] = configuration(end, values[end])
        views, site = values.pop("views"), values.pop("site", None)
        form: dict[str, Any] = {name: as_json(name, value) for name, value in values.items()}
        if len(views) > 0:
            form["view"] = [as_json("views", view) for view in views]
        if site is not None:
            form["site"] = site
        return form

    def read(self, answer: Answer) -> FoundPlan:
        """The plan, whose path leads from start to goal within the joints' limits."""
        members = parse_object(answer.body, "plan")
        # Null where none were asked for.
        members["alternatives"] = members.get("alternatives") or []
        found = read_object(
            FoundPlan,
            members,
            "plan",
            plan=read_object(Plan, members, "plan"),
            model=self.model_of(members, "plan"),
            round_trip_s=answer.round_trip_s,
            request_id=read_request_id(answer.headers),
        )
        query, space = self.query, found.model.space
        if found.seed != query.seed:
            raise unusable("is for another seed", str(query.seed), str(found.seed))
        if space is None:
            raise unusable("is no plan", "a joint space", "none")
        allowed = space if query.limits is None else space.narrowed(query.limits)
        return replace(found, plan=_checked(found.plan, query, allowed))


@dataclass(frozen=True, slots=True, eq=False)
class DoctorQuestion(Question[Diagnosis]):
    """A request for what is wrong with pictures."""

    path: ClassVar[str] = "/doctor"

    def read(self, answer: Answer) -> Diagnosis:
        """The diagnosis, whose poses are 4 x 4."""
        members = parse_object(answer.body, "diagnosis")
        head = self.model_of(members, "diagnosis")
        found = read_object(Diagnosis, members, "diagnosis", model=head, round_trip_s=answer.round_trip_s)
        for suggested in found.poses:
            if suggested.pose.shape != (4, 4):
                raise unusable("has no whole pose", "4 x 4 numbers", f"shape {suggested.pose.shape}")
        return found


@dataclass(frozen=True, slots=True)
class _Grid:
    counts: tuple[int, int, int]


@dataclass(frozen=True, slots=True, eq=False)
class BeliefQuestion(Question[Belief]):
    """A request for what a model takes the scene to be."""

    path: ClassVar[str] = "/belief"

    def read(self, answer: Answer) -> Belief:
        """The belief, with a byte for each cell."""
        members = parse_object(answer.body, "belief")
        counts = read_object(_Grid, members, "belief").counts
        try:
            packed = base64.b64decode(members["occupied"], validate=True)
        except (KeyError, TypeError, ValueError) as error:
            raise unusable("is no belief", "cells in base64", str(error)) from error
        if min(counts) < 1 or len(packed) != math.prod(counts):
            raise unusable("is no belief", "a byte for each cell", f"{len(packed)} of {counts}"[:100])
        cells = np.frombuffer(packed, np.uint8).reshape(counts).astype(np.float32) / np.float32(255.0)
        head = self.model_of(members, "belief")
        found = read_object(
            Belief, members, "belief", occupied=cells, model=head, round_trip_s=answer.round_trip_s
        )
        if found.low_m.shape != (3,):
            raise unusable("is no belief", "a corner of three numbers", f"shape {found.low_m.shape}")
        return found


def _checked(plan: Plan, query: PlanQuery, space: JointSpace) -> Plan:
    """A plan without a path that is none, that leads elsewhere, or with a lower confidence than requested.

    Raises:
        SamplerAnswerError: it has such a one.
    """
    for alternative in plan.alternatives:
        _require_path(alternative, query, space)
    if plan.least is not None and plan.least.configuration.shape != (space.dim,):
        raise unusable("has no whole configuration", f"{space.dim} joints", "others")
    unseen = () if plan.unseen is None else plan.unseen
    if plan.status == "solved":
        if plan.unseen is not None and plan.unseen.shape != plan.edges.shape:
            raise unusable("has no complete path", f"{len(plan.edges)} unseen shares", str(len(unseen)))
        _require_path(plan, query, space)
        return plan
    if any(map(len, (plan.path, plan.edges, unseen, plan.alternatives))):
        raise unusable("has a path although none was found", "none", plan.status)
    return replace(plan, path=np.empty((0, space.dim)))


def _require_path(found: Plan | AlternativePath, query: PlanQuery, space: JointSpace) -> None:
    corners = len(found.path)
    if corners < 2 or found.path.shape != (corners, space.dim) or found.edges.shape != (corners - 1,):
        got = f"shapes {found.path.shape} and {found.edges.shape}"
        raise unusable("has no complete path", f"corners of {space.dim} joints, edges between", got)
    if query.min_confidence is not None and found.confidence < query.min_confidence:
        raise unusable(
            "has a lower confidence than requested", str(query.min_confidence), str(found.confidence)
        )
    path = found.path
    if query.unwrapped:
        jumps = np.abs(np.diff(path, axis=0)) > np.pi + _SAME_RAD
        if (jumps & np.asarray(space.periodic)).any():
            raise unusable("has a path that jumps", "circles unwrapped", "more than half a turn at once")
        path = space.wrap(path)
    if not space.holds(path).all():
        ends = f"from {space.lower} to {space.upper}"
        raise unusable("leaves the joints' limits", ends[:200], "others")
    # Where the goal is a pose, the server chose the configuration.
    for end, corner in ((query.start, path[0]), (query.goal, path[-1])):
        if end is not None and not _same(end, corner, space):
            raise unusable("leads elsewhere", "a path from start to goal", "other ends")
    if query.unwrapped and np.abs(np.subtract(found.path[0], query.start)).max() > _SAME_RAD:
        raise unusable("leads elsewhere", "a path from the start as it is given", "other turns")


def _same(end: ArrayLike, corner: NDArray[np.float64], space: JointSpace) -> bool:
    """Whether two configurations are one, (d,) rad, circles at any turn."""
    fits = np.shape(end) == corner.shape
    return fits and bool(np.all(np.abs(space.wrap(np.subtract(end, corner))) <= _SAME_RAD))
