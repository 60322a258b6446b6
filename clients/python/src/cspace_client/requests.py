"""The requests of an inference API, one class for each endpoint, and how their answers are read."""

import base64
import io
import json
import math
from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any, ClassVar, Generic, Protocol, TypeVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from cspace_client.answers import (
    MAX_HEAD_BYTES,
    MAX_JOINTS,
    NPY,
    Members,
    SampleHead,
    max_body_bytes,
    parse_json,
    read_head,
    read_media_type,
    read_model_head,
    read_request_id,
    read_rows,
    read_samples,
    require_requested,
    share,
    space_of,
    warnings_of,
)
from cspace_client.errors import SamplerError, printable, unusable
from cspace_client.models import (
    MAX_SAMPLES,
    PLAIN,
    AlternativePath,
    Belief,
    Contact,
    Diagnosis,
    FoundPlan,
    JointSpace,
    LeastConfidence,
    ModelHead,
    NextView,
    Plan,
    PlanOptions,
    SampleBatch,
    Status,
    SuggestedPose,
    Verdict,
    Wanted,
    configuration,
    is_digest,
)
from cspace_client.pictures import File, Shown

Found = TypeVar("Found")
Found_co = TypeVar("Found_co", covariant=True)


class Reading(Protocol[Found_co]):
    """An answer whose head fits its question, and whose body follows."""

    @property
    def limit_bytes(self) -> int:
        """The longest body that can be right."""

    def conclude(self, body: bytes, round_trip_s: float) -> Found_co:
        """What the whole answer stands for.

        Args:
            body: whole.
            round_trip_s: how long it took.

        Raises:
            SamplerAnswerError: it can not be used.
        """


@dataclass(frozen=True, slots=True, eq=False)
class Question(ABC, Generic[Found]):
    """One request, which may be sent more than once: its seed makes every answer to it the same.

    Args:
        shown: the picture, as it is sent.
        model: ``name``, ``name@alias``, ``name/version`` or ``pretrained``; None for the default.
        robot: that is planned for; None for any.
        sends_robot: whether the robot is sent, which older servers refuse.
    """

    path: ClassVar[str]
    media_type: ClassVar[str]

    shown: Shown
    model: str | None
    robot: str | None
    sends_robot: bool

    @property
    def fields(self) -> dict[str, Any]:
        """The form's fields; what the endpoint takes for granted is left to it."""
        fields = {**self.shown.fields, **self.own_fields()}
        if self.robot is not None and self.sends_robot:
            fields["robot"] = self.robot
        if self.model is not None:
            fields["model"] = self.model
        return fields

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
    def read(self, headers: Mapping[str, str]) -> Reading[Found]:
        """Checks the head of an answer of status 200.

        Args:
            headers: of the answer; names in any case if the mapping does not mind it.

        Raises:
            SamplerAnswerError: a header is missing, wrong, or answers another question.
        """


@dataclass(frozen=True, slots=True, eq=False)
class SampleQuestion(Question[SampleBatch]):
    """A request for samples.

    Args:
        query: what is asked; its robot and what has to be confirmed are the question's.
    """

    path: ClassVar[str] = "/sample"
    media_type: ClassVar[str] = NPY

    query: Wanted

    def own_fields(self) -> dict[str, Any]:
        """What the endpoint takes for granted is left to it."""
        query = self.query
        fields: dict[str, Any] = {"n": str(query.n), "seed": str(query.seed)}
        if query.min_confidence is not None:
            fields["min_confidence"] = repr(query.min_confidence)
        if query.epsilon_sigma != PLAIN:
            fields["epsilon_sigma"] = [repr(value) for value in query.epsilon_sigma]
        for name, angles in (("start", query.start), ("goal", query.goal)):
            if angles is not None:
                fields[name] = json.dumps(angles)
        return fields

    def read(self, headers: Mapping[str, str]) -> "SampleReading":
        """See :class:`cspace_client.requests.Question`."""
        return SampleReading(self.query, read_head(headers, self.query, self.model))


@dataclass(frozen=True, slots=True)
class SampleReading:
    """See :class:`cspace_client.requests.Reading`."""

    query: Wanted
    head: SampleHead

    @property
    def limit_bytes(self) -> int:
        """Of so many samples; a server refuses more than it may be asked for."""
        return max_body_bytes(min(self.query.n, MAX_SAMPLES))

    def conclude(self, body: bytes, round_trip_s: float) -> SampleBatch:
        """The batch."""
        head, model = self.head, self.head.model
        return SampleBatch(
            samples=read_samples(body, self.query.n - head.shortfall, model.space),
            model_name=model.model_name,
            model_version=model.model_version,
            digest=model.digest,
            seed=head.seed,
            shortfall=head.shortfall,
            round_trip_s=round_trip_s,
            novelty=model.novelty,
            timing=head.timing,
            robot=model.robot,
            alias_confirmed=model.alias_confirmed,
            acceptance=head.acceptance,
            space=model.space,
            warnings=model.warnings,
            request_id=head.request_id,
        )


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
    threshold: float | None
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

    def own_files(self) -> list[tuple[str, File]]:
        """As a ``.npy``, which is shorter than JSON and exact."""
        file = io.BytesIO()
        np.save(file, np.ascontiguousarray(self.configurations, dtype="<f8"), allow_pickle=False)
        return [("configurations", ("configurations.npy", file.getvalue(), NPY))]

    def read(self, headers: Mapping[str, str]) -> "ValidityReading":
        """See :class:`cspace_client.requests.Question`."""
        read_media_type(headers, NPY)
        threshold = share(headers, "x-threshold") if "x-threshold" in headers else None
        head = read_model_head(headers, self.model, self.robot)
        return ValidityReading(len(self.configurations), threshold, head)


@dataclass(frozen=True, slots=True)
class ValidityReading:
    """See :class:`cspace_client.requests.Reading`."""

    rows: int
    threshold: float | None
    head: ModelHead

    @property
    def limit_bytes(self) -> int:
        """Two columns of float32."""
        return MAX_HEAD_BYTES + 8 * self.rows

    def conclude(self, body: bytes, round_trip_s: float) -> Predictions:
        """The predictions: shares from 0 to 1, where a second column is that or nowhere a number."""
        columns = read_rows(body, "predictions")
        if columns.shape != (self.rows, 2):
            raise unusable("holds another array", f"({self.rows}, 2)", str(columns.shape))
        confidence, unseen = columns[:, 0].copy(), columns[:, 1].copy()
        nowhere = bool(np.isnan(unseen).all())
        known = confidence if nowhere else columns
        # What is not a number is neither.
        if not ((known >= 0.0) & (known <= 1.0)).all():
            raise unusable("holds values that are no shares", "0 to 1", "others")
        return Predictions(confidence, None if nowhere else unseen, self.threshold, self.head, round_trip_s)


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


JSON = "application/json"
# Of a path with thousands of corners.
_MAX_BYTES = 4 * 1024 * 1024
_MAX_NAME = 256
# Start and goal come back as circles are written: within a turn, in the numbers that were sent.
_SAME_RAD = 1e-6
_STATUSES: tuple[Status, ...] = ("solved", "refused", "timeout")


@dataclass(frozen=True, slots=True, eq=False)
class PlanQuestion(Question[FoundPlan]):
    """A request for a path.

    Args:
        query: what is asked.
    """

    path: ClassVar[str] = "/plan"
    media_type: ClassVar[str] = JSON

    query: PlanOptions

    def own_fields(self) -> dict[str, Any]:
        """All of the query; of what older servers do not know, what is not taken for granted."""
        query = self.query
        names = "next_view", "alternatives", "explain", "unwrapped"
        flags = {name: getattr(query, name, False) for name in names}
        fields: dict[str, Any] = {name: "true" for name, wanted in flags.items() if wanted}
        if query.views:
            fields["view"] = [json.dumps(dict(view)) for view in query.views]
        if query.time_limit_s is not None:
            fields["time_limit_s"] = repr(float(query.time_limit_s))
        if query.ways is not None:
            fields["ways"] = str(query.ways)
        if query.min_confidence is not None:
            fields["min_confidence"] = repr(float(query.min_confidence))
        if (site := getattr(query, "site", None)) is not None:
            fields["site"] = site
        if query.goal is not None:
            fields["goal"] = json.dumps(configuration("goal", query.goal))
        constraints = {"goal_pose": query.goal_pose, "limits": query.limits, "upright": query.upright}
        given = {name: value for name, value in constraints.items() if value is not None}
        fields |= {name: _json(name, value) for name, value in given.items()}
        return fields | {
            "start": json.dumps(configuration("start", query.start)),
            "seed": str(query.seed),
        }

    def read(self, headers: Mapping[str, str]) -> "PlanReading":
        """See :class:`cspace_client.requests.Question`."""
        read_media_type(headers, JSON)
        return PlanReading(self, read_request_id(headers))


@dataclass(frozen=True, slots=True, eq=False)
class PlanReading:
    """See :class:`cspace_client.requests.Reading`."""

    question: PlanQuestion
    request_id: str | None

    @property
    def limit_bytes(self) -> int:
        """Of JSON."""
        return _MAX_BYTES

    def conclude(self, body: bytes, round_trip_s: float) -> FoundPlan:
        """The plan, whose path leads from start to goal within the joints' limits."""
        try:
            answer = Members(parse_json(body), "plan")
        except ValueError as error:
            raise unusable("is no plan", "the members of a plan", str(error)) from error
        query, seed = self.question.query, answer.seed("seed")
        if seed != query.seed:
            raise unusable("is for another seed", str(query.seed), str(seed))
        head = _head(self.question, answer)
        space = space_of(answer.plain("joint_space"), f"joint_space: {str(answer.plain('joint_space'))[:80]}")
        plan = _plan(answer, space)
        limits = query.limits
        _require_fit(plan, query, space if limits is None else space.narrowed(limits))
        reason = printable(answer.text("reason")) if answer.has_required("reason") else None
        warnings = warnings_of(answer) if answer.has("warnings") else ()
        head = replace(head, space=space, warnings=warnings)
        named = answer.has("calibration") and answer.has_required("calibration")
        calibration = printable(answer.text("calibration", _MAX_NAME)) if named else None
        return FoundPlan(plan, reason, seed, head, round_trip_s, self.request_id, calibration)


def _json(name: str, value: object) -> str:
    """Plain values, and arrays and NumPy's numbers among them, as JSON.

    Raises:
        SamplerError: they are none, or not finite.
    """
    try:
        plain = dict(value) if isinstance(value, Mapping) else value
        return json.dumps(plain, default=lambda one: np.asarray(one, np.float64).tolist(), allow_nan=False)
    except (TypeError, ValueError) as error:
        raise SamplerError(
            f"{name} is wrong", expected="finite numbers, lists and mappings", got=str(error)[:200]
        ) from error


def _head(question: Question[Any], answer: Members) -> ModelHead:
    model, scenario = answer.inner("model"), answer.inner("scenario")
    name, version, robot = model.text("name", _MAX_NAME), model.count("version"), model.text("robot")
    digest = model.text("digest")
    for what, value in (("digest", digest), ("robot", robot)):
        if not is_digest(value):
            raise unusable(f"names a wrong {what}", "a SHA-256 in hexadecimal", repr(value[:80]))
    require_requested(question.model, question.robot, name, version, robot)
    return ModelHead(
        printable(name),
        version,
        digest,
        robot=robot,
        alias_confirmed=model.flag("alias_confirmed"),
        novelty=scenario.number("novelty", 1.0) if scenario.has_required("novelty") else None,
    )


@dataclass(frozen=True, slots=True, eq=False)
class DoctorQuestion(Question[Diagnosis]):
    """A request for what is wrong with pictures."""

    path: ClassVar[str] = "/doctor"
    media_type: ClassVar[str] = JSON

    def read(self, headers: Mapping[str, str]) -> "DoctorReading":
        """See :class:`cspace_client.requests.Question`."""
        read_media_type(headers, JSON)
        return DoctorReading(self)


@dataclass(frozen=True, slots=True, eq=False)
class DoctorReading:
    """See :class:`cspace_client.requests.Reading`."""

    question: DoctorQuestion

    @property
    def limit_bytes(self) -> int:
        """Of JSON."""
        return _MAX_BYTES

    def conclude(self, body: bytes, round_trip_s: float) -> Diagnosis:
        """The diagnosis, whose poses are 4 x 4."""
        try:
            answer = Members(parse_json(body), "diagnosis")
        except ValueError as error:
            raise unusable("is no diagnosis", "the members of one", str(error)) from error
        return Diagnosis(
            tuple(
                Verdict(
                    printable(one.text("code")),
                    printable(one.text("seen")),
                    printable(one.text("effect")),
                    printable(one.text("remedy")),
                    tuple(int(number) for number in one.row("pictures")),
                )
                for one in answer.each("verdicts")
            ),
            tuple(map(printable, answer.texts("notes"))),
            tuple(map(_suggested, answer.each("poses"))),
            _head(self.question, answer),
            round_trip_s,
        )


@dataclass(frozen=True, slots=True, eq=False)
class BeliefQuestion(Question[Belief]):
    """A request for what a model takes the scene to be."""

    path: ClassVar[str] = "/belief"
    media_type: ClassVar[str] = JSON

    def read(self, headers: Mapping[str, str]) -> "BeliefReading":
        """See :class:`cspace_client.requests.Question`."""
        read_media_type(headers, JSON)
        return BeliefReading(self)


@dataclass(frozen=True, slots=True, eq=False)
class BeliefReading:
    """See :class:`cspace_client.requests.Reading`."""

    question: BeliefQuestion

    @property
    def limit_bytes(self) -> int:
        """Of JSON."""
        return _MAX_BYTES

    def conclude(self, body: bytes, round_trip_s: float) -> Belief:
        """The belief, with a byte for each cell."""
        try:
            answer = Members(parse_json(body), "belief")
            packed = base64.b64decode(answer.text("occupied", _MAX_BYTES), validate=True)
        except ValueError as error:
            raise unusable("is no belief", "the members of one", str(error)) from error
        counts, low_m = [int(count) for count in answer.row("counts")], answer.row("low_m")
        fits = len(counts) == len(low_m) == 3 and min(counts) > 0
        if not fits or len(packed) != math.prod(counts):
            raise unusable("is no belief", "a byte for each cell", f"{len(packed)} of {counts}"[:100])
        return Belief(
            np.array(low_m),
            answer.number("cell_m"),
            np.frombuffer(packed, np.uint8).reshape(counts).astype(np.float32) / np.float32(255.0),
            _head(self.question, answer),
            round_trip_s,
        )


def _suggested(one: Members) -> SuggestedPose:
    rows = one.rows("pose")
    if [len(row) for row in rows] != [4] * 4:
        raise unusable("has no whole pose", "4 x 4 numbers", f"rows of {[len(row) for row in rows][:8]}")
    pose = np.array(rows, dtype=np.float64)
    return SuggestedPose(one.count("picture"), pose, one.number("offset_m"), one.number("turn_deg"))


def _plan(answer: Members, space: JointSpace) -> Plan:
    least = answer.inner("least_sure") if answer.has_required("least_sure") else None
    view = answer.inner("next_view") if answer.has("next_view") else None
    timing = answer.inner("timing_ms")
    return Plan(
        status=answer.one_of("status", _STATUSES),
        path=_path(answer, space),
        confidence=answer.number("confidence", 1.0),
        edges=np.array(answer.shares("edges"), dtype=np.float32),
        unseen=np.array(answer.shares("unseen"), dtype=np.float32) if answer.has_required("unseen") else None,
        length_rad=answer.number("length_rad"),
        found=answer.count("ways"),
        least=None if least is None else _least(least, space),
        next_view=None if view is None else NextView(view.plain("camera"), view.number("sees", 1.0)),
        alternatives=tuple(
            AlternativePath(
                _path(one, space),
                one.number("confidence", 1.0),
                np.array(one.shares("edges"), dtype=np.float32),
            )
            for one in (answer.each("alternatives") if answer.has("alternatives") else ())
        ),
        contact=_contact(answer.inner("contact")) if answer.has("contact") else None,
        search_ms=timing.number("search"),
        score_ms=timing.number("score"),
    )


def _contact(one: Members) -> Contact:
    place = one.row("position_m")
    if len(place) != 3:
        raise unusable("has a contact at no place", "three numbers", str(len(place)))
    return Contact(
        kind=printable(one.text("kind")),
        link=printable(one.text("link")),
        other=printable(one.text("other")),
        position_m=(place[0], place[1], place[2]),
        depth_m=one.number("depth_m"),
        text=printable(one.text("text")),
    )


def _least(least: Members, space: JointSpace) -> LeastConfidence:
    unseen = least.number("unseen", 1.0) if least.has_required("unseen") else None
    row = _rows([least.row("configuration")], space)[0]
    return LeastConfidence(row, least.number("confidence", 1.0), unseen, least.number("along", 1.0))


def _path(answer: Members, space: JointSpace) -> NDArray[np.float64]:
    return _rows(answer.rows("path"), space)


def _rows(rows: list[list[float]], space: JointSpace) -> NDArray[np.float64]:
    if any(len(row) != space.dim for row in rows):
        raise unusable("has no complete path", f"corners of {space.dim} joints", "others")
    return np.array(rows, dtype=np.float64).reshape(len(rows), space.dim)


def _require_fit(plan: Plan, query: PlanOptions, space: JointSpace) -> None:
    """Refuse a path that is none, that leads elsewhere, or with a lower confidence than requested.

    Raises:
        SamplerAnswerError: it is such a one.
    """
    for alternative in plan.alternatives:
        _require_path(alternative, query, space)
    unseen = () if plan.unseen is None else plan.unseen
    if plan.status == "solved":
        if plan.unseen is not None and len(unseen) != len(plan.edges):
            raise unusable("has no complete path", f"{len(plan.edges)} unseen shares", str(len(unseen)))
        _require_path(plan, query, space)
    elif any(map(len, (plan.path, plan.edges, unseen, plan.alternatives))):
        raise unusable("has a path although none was found", "none", plan.status)


def _require_path(found: Plan | AlternativePath, query: PlanOptions, space: JointSpace) -> None:
    pieces = len(found.path) - 1
    if pieces < 1 or len(found.edges) != pieces:
        raise unusable("has no complete path", "two corners or more, edges between", f"{pieces} edges")
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
    wanted = [end for end in (query.start, query.goal) if end is not None]
    ends_rad = [np.asarray(end, dtype=np.float64) for end in wanted]
    if (
        any(end.shape != (space.dim,) for end in ends_rad)
        or (space.distance(ends_rad, path[[0, -1]][: len(ends_rad)]) > _SAME_RAD).any()
        or (query.unwrapped and np.abs(found.path[0] - ends_rad[0]).max() > _SAME_RAD)
    ):
        raise unusable("leads elsewhere", "a path from start to goal", "other ends")
