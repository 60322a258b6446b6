"""What is asked of a sampler and of a planner, and what they answer."""

import math
import re
import secrets
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Annotated, Any, Literal, Protocol, TypedDict

import numpy as np
from numpy.typing import ArrayLike, NDArray

from cspace_client.errors import SamplerError
from cspace_client.pictures import Picture

MAX_LIMIT_RAD = 1000.0
"""Of a joint, either way; further out single precision tells neighbours no longer apart."""

LIMIT_TOLERANCE_RAD = 1e-4
"""A value that lies this little beyond a limit is there by rounding, and is taken as that limit."""

_TURN = 2.0 * np.pi
MAX_CIRCLE_RAD = 3.0 * _TURN
"""Farther from 0 an angle of a circle is more likely in degrees than unwrapped."""


class Joints(Protocol):
    """What a planner's draws need of a joint space, whoever made it."""

    @property
    def dim(self) -> int:
        """d, number of joints."""

    @property
    def lower(self) -> tuple[float, ...]:
        """Lower end of each joint, rad."""

    @property
    def upper(self) -> tuple[float, ...]:
        """Upper end of each joint, rad."""

    @property
    def periodic(self) -> tuple[bool, ...]:
        """Whether each joint is a circle."""

    def wrap(self, configurations: ArrayLike) -> NDArray[np.float64]:
        """Periodic joints brought into [-pi, pi), the others as they are; (..., d) rad."""

    def sample_uniform(self, rng: np.random.Generator, count: int) -> NDArray[np.float64]:
        """``count`` uniform configurations, (count, d) rad."""


@dataclass(frozen=True, slots=True)
class JointSpace:
    """Circles for periodic joints, intervals for the others.

    Args:
        lower: lower end of each joint, rad; -pi where periodic.
        upper: upper end of each joint, rad; pi where periodic.
        periodic: whether the joint is a circle.
    """

    lower: tuple[float, ...]
    upper: tuple[float, ...]
    periodic: tuple[bool, ...]

    @property
    def dim(self) -> int:
        """Number of joints."""
        return len(self.lower)

    def sample_uniform(self, rng: np.random.Generator, count: int) -> NDArray[np.float64]:
        """``count`` uniform configurations, (count, d) rad."""
        return rng.uniform(self.lower, self.upper, size=(count, self.dim))

    def wrap(self, configurations: ArrayLike) -> NDArray[np.float64]:
        """Periodic joints brought into [-pi, pi), the others as they are; (..., d) rad."""
        values = np.asarray(configurations, dtype=np.float64)
        wrapped = np.mod(values + np.pi, _TURN) - np.pi
        # The modulo of a tiny negative number rounds up to the full period.
        return np.where(self.periodic, np.where(wrapped >= np.pi, -np.pi, wrapped), values)

    def clamp(self, configurations: ArrayLike) -> NDArray[np.float64]:
        """Joints that lie up to ``LIMIT_TOLERANCE_RAD`` beyond a limit brought to it; (..., d) rad."""
        values = np.asarray(configurations, dtype=np.float64)
        inside = np.clip(values, self.lower, self.upper)
        near = ~np.asarray(self.periodic) & (np.abs(values - inside) <= LIMIT_TOLERANCE_RAD)
        return np.where(near, inside, values)

    def admits(self, configurations: ArrayLike) -> NDArray[np.bool_]:
        """Whether each of (..., d) lies within its limits, and its circles within ``MAX_CIRCLE_RAD`` of 0."""
        values = np.asarray(configurations, dtype=np.float64)
        inside = (values >= self.lower) & (values <= self.upper)
        near = np.abs(values) <= MAX_CIRCLE_RAD
        return np.asarray(np.all(np.where(self.periodic, near, inside), axis=-1))

    def narrowed(self, limits: Sequence[Sequence[float] | None]) -> "JointSpace":
        """The space whose joints keep to ranges (low, high) rad; None leaves one as it is.

        A circle with a range is none any more: its angles are the numbers from low to high.
        """
        own = zip(self.lower, self.upper, limits, strict=True)
        ends = [(low, high) if given is None else (given[0], given[1]) for low, high, given in own]
        circles = zip(self.periodic, limits, strict=True)
        return JointSpace(
            tuple(float(low) for low, _ in ends),
            tuple(float(high) for _, high in ends),
            tuple(wraps and given is None for wraps, given in circles),
        )

    def holds(self, configurations: NDArray[np.floating[Any]]) -> NDArray[np.bool_]:
        """Which values of (..., d) lie in their joint's range, circles in [-pi, pi).

        Limits are compared in the precision of the values, for they may have been rounded to it.
        """
        low, high = (np.asarray(ends, dtype=configurations.dtype) for ends in (self.lower, self.upper))
        limited = (configurations >= low) & (configurations <= high)
        exact = configurations.astype(np.float64)
        return np.where(self.periodic, (exact >= -np.pi) & (exact < np.pi), limited)


def circles(dim: int) -> JointSpace:
    """``dim`` joints without limits."""
    return JointSpace((-np.pi,) * dim, (np.pi,) * dim, (True,) * dim)


_DIGEST = "[0-9a-f]{64}"


@dataclass(frozen=True, slots=True)
class Wire:
    """Where a field stands in an answer and what it may hold, in the annotation of a dataclass's field.

    Args:
        at: its place in JSON, with dots between the names of nested objects; the field's own name when empty.
        header: that holds it in answers without JSON.
        most: of a number or of each of an array, which is then at least 0.
        pattern: of a whole text.
    """

    at: str = ""
    header: str = ""
    most: float = math.inf
    pattern: str = ""


_Share = Annotated[float, Wire(most=1.0)]
_Edges = Annotated[NDArray[np.float32], Wire(most=1.0)]


@dataclass(frozen=True, slots=True)
class PictureWarning:
    """Something about the pictures of a request that makes its answer worse or wrong.

    Args:
        code: a name that never changes, as ``no-surface-in-reach``; the API's document lists them.
        message: what was seen, what it does to the answer, and what to do, in the server's words.
        pictures: numbers of the pictures that it is about, from 0; none where it is about all.
    """

    code: str
    message: str
    pictures: tuple[int, ...] = ()


_Name = Annotated[str, Wire("model.name", "x-model-name", pattern="[ -~]{1,256}")]
_Version = Annotated[int, Wire("model.version", "x-model-version")]
_Digest = Annotated[str, Wire("model.digest", "x-model-digest", pattern=_DIGEST)]
_Novelty = Annotated[float | None, Wire("scenario.novelty", "x-novelty", most=1.0)]
_Space = Annotated[JointSpace | None, Wire("joint_space", "x-joint-space")]
_Robot = Annotated[str | None, Wire("model.robot", "x-robot", pattern=_DIGEST)]
_Confirmed = Annotated[bool | None, Wire("model.alias_confirmed", "x-alias-confirmed")]
_Warnings = Annotated[tuple[PictureWarning, ...], Wire("warnings", "x-warnings")]


@dataclass(frozen=True, slots=True)
class ModelHead:
    """The model that answered, and what it holds of the picture.

    Args:
        model_name: as :class:`cspace_client.models.SampleBatch` has it, and so the rest.
        model_version: likewise.
        digest: likewise.
        novelty: likewise.
        space: of its robot; None where it is not told.
        robot: likewise.
        alias_confirmed: likewise.
        warnings: likewise.
    """

    model_name: _Name
    model_version: _Version
    digest: _Digest
    novelty: _Novelty = None
    space: _Space = None
    robot: _Robot = None
    alias_confirmed: _Confirmed = None
    warnings: _Warnings = ()


@dataclass(frozen=True, slots=True)
class Verdict:
    """Something that is wrong with the pictures of a request, or may be, in the server's words.

    Args:
        code: a name that never changes, as ``extrinsics``.
        seen: what was seen.
        effect: what it does to answers.
        remedy: what to do.
        pictures: numbers of the pictures that it is about, from 0; none where it is about all.
    """

    code: str
    seen: str
    effect: str
    remedy: str
    pictures: tuple[int, ...] = ()


@dataclass(frozen=True, slots=True, eq=False)
class SuggestedPose:
    """Where a camera seems to stand.

    Args:
        picture: number of its picture, from 0.
        pose: (4, 4) float64, of its optical frame in the robot's base, m.
        offset_m: its distance from the pose that was sent.
        turn_deg: how far it is turned from there.
    """

    picture: int
    pose: NDArray[np.float64]
    offset_m: float
    turn_deg: float


@dataclass(frozen=True, slots=True, eq=False)
class Diagnosis:
    """What a close look at pictures finds.

    Args:
        verdicts: none where nothing wrong was found.
        notes: what was seen and is not wrong, or could not be tested.
        poses: of cameras for which a better one is clear.
        model: that answered, with the novelty.
        round_trip_s: from the request to the checked answer, further attempts included.
    """

    verdicts: tuple[Verdict, ...]
    notes: tuple[str, ...]
    poses: tuple[SuggestedPose, ...]
    model: ModelHead
    round_trip_s: float


@dataclass(frozen=True, slots=True, eq=False)
class Belief:
    """What a model takes a scene to be, seen or not, on a grid of cells in the robot's base.

    Args:
        low_m: (3,) lowest corner of the grid.
        cell_m: side of a cell.
        occupied: (X, Y, Z) the probability that a ball of the cell's width in its middle touches something.
        model: that answered, with the novelty.
        round_trip_s: from the request to the checked answer, further attempts included.
    """

    low_m: NDArray[np.float64]
    cell_m: float
    occupied: NDArray[np.float32]
    model: ModelHead
    round_trip_s: float

    def centres_m(self, least: float) -> NDArray[np.float64]:
        """(N, 3): middles of the cells whose probability is at least that, m, in the order of the array."""
        return np.asarray(self.low_m + self.cell_m * (np.argwhere(self.occupied >= least) + 0.5))


MAX_SAMPLES = 20_000
"""Of one request."""

PLAIN = (0.0,)
"""The schedule that leaves the encoder's standard deviation as it is."""


class QueryOptions(TypedDict, total=False):
    """What a call that asks for samples may leave out, as :class:`SampleQuery` has it."""

    epsilon_sigma: Sequence[float]
    start: ArrayLike | None
    goal: ArrayLike | None
    min_confidence: float | None
    robot: str | None


@dataclass(frozen=True, slots=True)
class SampleQuery:
    """A request for samples; the server checks its ranges.

    Args:
        n: how many, 1 to ``MAX_SAMPLES``.
        seed: unsigned 64 bit.
        epsilon_sigma: the latent's standard deviation is raised by each value, 0 to 10; equal shares of the
            samples in this order, the remainder to the first.
        start: (d,) rad, for path models and only for them.
        goal: as ``start``.
        min_confidence: what the validity head has to score, 0 to 1; None for the model's own threshold,
            0 for all samples as they come.
        robot: whose configurations are wanted, the digest that ``GET /models`` tells; None for any.
    """

    n: int
    seed: int
    epsilon_sigma: tuple[float, ...] = PLAIN
    start: tuple[float, ...] | None = None
    goal: tuple[float, ...] | None = None
    min_confidence: float | None = None
    robot: str | None = None

    @classmethod
    def of(
        cls,
        n: int,
        seed: int | None,
        epsilon_sigma: Sequence[float] = PLAIN,
        start: ArrayLike | None = None,
        goal: ArrayLike | None = None,
        min_confidence: float | None = None,
        robot: str | None = None,
    ) -> "SampleQuery":
        """The query of numbers and arrays of any kind; without a seed one is drawn.

        Raises:
            SamplerError: a value is of another kind.
        """
        return cls(
            _whole("n", n),
            random_seed() if seed is None else _whole("seed", seed),
            configuration("epsilon_sigma", epsilon_sigma),
            None if start is None else configuration("start", start),
            None if goal is None else configuration("goal", goal),
            None if min_confidence is None else configuration("min_confidence", [min_confidence])[0],
            robot,
        )


@dataclass(frozen=True, slots=True)
class SourceTiming:
    """Where a source's own time went, in s; what a round trip takes beyond the total is transport.

    Args:
        decode_s: reading the picture; 0 for one that was known.
        encode_s: the picture's latent; 0 for one that was known.
        generate_s: drawing, and scoring where that is asked for.
        total_s: all of it, what the other three leave out among it.
    """

    decode_s: float
    encode_s: float
    generate_s: float
    total_s: float


@dataclass(frozen=True, slots=True, eq=False)
class SampleBatch:
    """Learned samples for one picture, with the model they come from.

    Args:
        samples: (n, d) float32 rad, circles in [-pi, pi), other joints within the limits that are told.
        model_name: of the model that answered; ``pretrained`` for the one that ships with the server.
        model_version: its number in the registry.
        digest: of its bundle.
        seed: that was used, whether asked for or drawn.
        shortfall: how many fewer samples came than were asked for.
        round_trip_s: from the request to the checked answer, further attempts included.
        novelty: how unlike the model's training scenarios the picture is, 0 to 1; None where it is not told.
        fallback: whether another source answered because the server stayed away.
        timing: where the source's own time went; None where it is not told.
        acceptance: share of what was drawn that reached the confidence asked for; None where it is not told.
        robot: whose configurations they are, the SHA-256 that ``GET /models`` tells beside the robot itself;
            None where it is not told.
        alias_confirmed: whether the server has confirmed which version the alias names; None where it is not
            told.
        confidence: (n,) float32, what the model's validity head scores each sample, 0 to 1; None for a model
            without one, for samples that were not filtered by it, and over HTTP, whose ``.npy`` has no room
            for it.
        space: the joint space; None where it is not told.
        warnings: what is wrong, or may be, with the pictures.
        request_id: under which outcomes are told of it; None where no server answered.
    """

    samples: NDArray[np.float32]
    model_name: _Name
    model_version: _Version
    digest: _Digest
    seed: Annotated[int, Wire(header="x-seed")]
    shortfall: Annotated[int, Wire(header="x-shortfall")]
    round_trip_s: float
    fallback: bool = False
    novelty: _Novelty = None
    timing: SourceTiming | None = None
    acceptance: Annotated[float | None, Wire(header="x-acceptance", most=1.0)] = None
    robot: _Robot = None
    alias_confirmed: _Confirmed = None
    confidence: NDArray[np.float32] | None = None
    space: _Space = None
    warnings: _Warnings = ()
    request_id: str | None = None


class Source(Protocol):
    """Whatever answers with samples: a client, or what stands in for a server."""

    def answer(self, picture: Picture, query: SampleQuery, model: str | None = None) -> SampleBatch:
        """At most ``query.n`` samples, of the same picture and seed the same.

        Raises:
            SamplerError: it has no answer.
        """


def is_digest(value: object) -> bool:
    """Whether a value is a SHA-256 in hexadecimal, in small letters."""
    return isinstance(value, str) and re.fullmatch(_DIGEST, value) is not None


def random_seed() -> int:
    """A seed; with it a request that is sent again is the same request."""
    return secrets.randbits(64)


def configuration(name: str, value: ArrayLike) -> tuple[float, ...]:
    """Finite numbers (d,) as JSON can hold them.

    Raises:
        SamplerError: they are none.
    """
    try:
        numbers = np.asarray(value, dtype=np.float64)
    except (TypeError, ValueError):
        numbers = np.array(np.nan)
    if numbers.ndim != 1 or not np.isfinite(numbers).all():
        raise SamplerError(f"{name} is wrong", expected="finite numbers, one dimension", got=str(value)[:200])
    return tuple(numbers.tolist())


def _whole(name: str, value: int) -> int:
    try:
        whole = int(value)
    except (TypeError, ValueError, OverflowError):
        whole = -1
    # Neither a half nor a text.
    if whole < 0 or whole != value or isinstance(value, bool):
        raise SamplerError(f"{name} is wrong", expected="a whole number, not negative", got=repr(value)[:200])
    return whole


Status = Literal["solved", "refused", "timeout"]


@dataclass(frozen=True, slots=True)
class PlanQuery:
    """A planning problem for a scene that a picture shows; the server checks its ranges.

    Args:
        start: (d,) rad.
        goal: (d,) rad; None where ``goal_pose`` says where the path ends.
        seed: of all draws, unsigned 64 bit.
        min_confidence: below which no path is returned, 0 to 1; None for the server's own.
        time_limit_s: for the search; None for the server's own.
        ways: number of paths to look for; None for the server's own number.
        next_view: whether the camera is wanted that would see most of what makes the path uncertain.
        views: cameras to choose it from, as plain values; none for some about the uncertain places.
        alternatives: whether all paths of sufficient confidence are wanted, for those who can check them.
        explain: whether an answer without a path says what is in the way.
        goal_pose: of the tool in the robot's base, as plain values: ``pose``, 4 x 4 or ``translation`` with
            ``quaternion_xyzw``, and where wanted ``tolerance_m``, ``tolerance_rad`` and ``free_z_rotation``.
        limits: for each joint low and high, rad, that the path keeps to, or None for the joint's own.
        upright: ``axis`` of the tool that the path keeps within ``max_rad`` of ``up`` in the base frame.
        unwrapped: whether circles go on beyond [-pi, pi) along the path, from the start as it is given.
        site: name of the place, whose own calibration of the confidence is to be used.
        keep: whether the server may keep pictures and path, to train on what becomes of the plan.
    """

    start: Sequence[float]
    goal: Sequence[float] | None = None
    seed: int = 0
    min_confidence: float | None = None
    time_limit_s: float | None = None
    ways: int | None = None
    next_view: bool = False
    views: Sequence[Mapping[str, Any]] = ()
    alternatives: bool = False
    explain: bool = False
    goal_pose: Mapping[str, Any] | None = None
    limits: Sequence[Sequence[float] | None] | None = None
    upright: Mapping[str, Any] | None = None
    unwrapped: bool = False
    site: str | None = None
    keep: bool = False


@dataclass(frozen=True, slots=True, eq=False)
class LeastConfidence:
    """Where the confidence of a path is lowest.

    Args:
        configuration: (d,) rad.
        confidence: of it alone.
        unseen: share of the robot that no picture shows there; None in worlds that are seen whole.
        along: how far along the path it lies, 0 to 1.
    """

    configuration: NDArray[np.float64]
    confidence: _Share
    unseen: _Share | None
    along: _Share


@dataclass(frozen=True, slots=True, eq=False)
class AlternativePath:
    """A path and a model's confidence in it.

    Args:
        path: (k, d) rad from start to goal.
        confidence: that the whole path touches nothing.
        edges: (k - 1,) the least confidence of a state on each of its pieces.
    """

    path: NDArray[np.float64]
    confidence: _Share
    edges: _Edges


@dataclass(frozen=True, slots=True)
class NextView:
    """A camera that would see more.

    Args:
        camera: as plain values.
        sees: share of the cost along a path that lies on space it would see, 0 to 1.
    """

    camera: Mapping[str, Any]
    sees: _Share


@dataclass(frozen=True, slots=True)
class Contact:
    """What is in the way of a configuration.

    Args:
        kind: ``known`` body, ``self``, ``seen`` surface, or space ``hidden`` behind one, ``unread`` or ``out
            of view``.
        link: the part of the robot, or the attached body.
        other: the body or part that it touches; empty for what pictures show.
        position_m: of the place on the robot, in its base frame.
        depth_m: how deep it is in; 0 in unknown space.
        text: in words.
    """

    kind: str
    link: str
    other: str
    position_m: tuple[float, float, float]
    depth_m: float
    text: str


@dataclass(frozen=True, slots=True, eq=False)
class Plan:
    """A path, or none.

    Args:
        status: ``solved``; ``refused`` where no path is confident enough or none was found; ``timeout`` where
            none was found in time.
        path: (k, d) rad from start to goal, (0, d) unless it is solved.
        confidence: that the whole path touches nothing; of the best one where it is refused, 0 without one.
        edges: (k - 1,) the least confidence of a state on each of its pieces.
        unseen: (k - 1,) the largest share of the robot on each piece that no picture shows; None in worlds
            that are seen whole.
        length_rad: Euclidean.
        found: paths that the best was chosen from.
        least: where the confidence of the best path is lowest; None without one.
        next_view: the camera that would see most of what makes that path uncertain; None where none was asked
            for, or none would see more.
        alternatives: all paths of sufficient confidence, the best first, which is the plan's; none where they
            were not asked for.
        search_ms: looking for paths.
        score_ms: asking the model about them.
        contact: what is in the way where there is no path; None where nothing is, or nobody asked.
    """

    status: Status
    path: NDArray[np.float64]
    confidence: _Share
    edges: _Edges
    unseen: _Edges | None
    length_rad: float
    found: Annotated[int, Wire("ways")]
    least: Annotated[LeastConfidence | None, Wire("least_sure")]
    next_view: NextView | None
    alternatives: tuple[AlternativePath, ...]
    search_ms: Annotated[float, Wire("timing_ms.search")]
    score_ms: Annotated[float, Wire("timing_ms.score")]
    contact: Contact | None = None


@dataclass(frozen=True, slots=True, eq=False)
class FoundPlan:
    """A path, or why there is none.

    Args:
        plan: the answer.
        reason: of what is not solved, in the server's words; None of what is.
        seed: that was used.
        model: that answered.
        round_trip_s: from the request to the checked answer, further attempts included.
        request_id: under which outcomes are told of it; None where the answer has none.
        calibration: that the confidence is by, as ``name/version``; None where it is the model's own.
        kept: whether the server keeps pictures and path, of a query with ``keep``.
    """

    plan: Plan
    reason: str | None
    seed: int
    model: ModelHead
    round_trip_s: float
    request_id: str | None = None
    calibration: str | None = None
    kept: bool = False
