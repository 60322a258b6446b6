"""Joint spaces, and answers as a program uses them: arrays, the model, warnings."""

import base64
import secrets
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Protocol, Self, TypeVar

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydantic import BaseModel

from cspace_client.wire import (
    BeliefAnswer,
    DoctorAnswer,
    JointSpaceInfo,
    PictureWarning,
    PlanAnswer,
    PlanQuery,
    SampleAnswer,
    SampleQuery,
    ValidityAnswer,
)

LIMIT_TOLERANCE_RAD = 1e-4
"""A value that lies this little beyond a limit is taken as that limit."""
MAX_CIRCLE_RAD = 6.0 * np.pi
"""Farther from 0 an angle of a circle is more likely in degrees than unwrapped."""


class Joints(Protocol):
    """What a planner needs of a joint space."""

    @property
    def dim(self) -> int:
        """Number of joints."""

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
        """Circles brought into [-pi, pi), other joints as they are; (..., d) rad."""

    def sample_uniform(self, rng: np.random.Generator, count: int) -> NDArray[np.float64]:
        """``count`` uniform configurations, (count, d) rad."""


@dataclass(frozen=True, slots=True)
class JointSpace:
    """Circles for periodic joints, with ends of -pi and pi, and intervals for the others, in rad."""

    lower: tuple[float, ...]
    upper: tuple[float, ...]
    periodic: tuple[bool, ...]

    @classmethod
    def of(cls, info: JointSpaceInfo) -> "JointSpace":
        """The joint space of an answer."""
        if info.lower is None or info.upper is None or info.periodic is None:
            return circles(info.dim)
        return cls(tuple(info.lower), tuple(info.upper), tuple(info.periodic))

    @property
    def dim(self) -> int:
        """Number of joints."""
        return len(self.lower)

    def sample_uniform(self, rng: np.random.Generator, count: int) -> NDArray[np.float64]:
        """``count`` uniform configurations, (count, d) rad."""
        return rng.uniform(self.lower, self.upper, size=(count, self.dim))

    def wrap(self, configurations: ArrayLike) -> NDArray[np.float64]:
        """Circles brought into [-pi, pi), other joints as they are; (..., d) rad."""
        values = np.asarray(configurations, dtype=np.float64)
        wrapped = np.mod(values + np.pi, 2.0 * np.pi) - np.pi
        # The modulo of a tiny negative number rounds up to the full period.
        return np.where(self.periodic, np.where(wrapped >= np.pi, -np.pi, wrapped), values)

    def clamp(self, configurations: ArrayLike) -> NDArray[np.float64]:
        """Joints that lie up to ``LIMIT_TOLERANCE_RAD`` beyond a limit brought to it; (..., d) rad."""
        values = np.asarray(configurations, dtype=np.float64)
        inside = np.clip(values, self.lower, self.upper)
        near = ~np.asarray(self.periodic) & (np.abs(values - inside) <= LIMIT_TOLERANCE_RAD)
        return np.where(near, inside, values)

    def admits(self, configurations: ArrayLike) -> NDArray[np.bool_]:
        """Whether each of (..., d) lies within its limits, and its circles within three turns of 0."""
        values = np.asarray(configurations, dtype=np.float64)
        inside = (values >= self.lower) & (values <= self.upper)
        near = np.abs(values) <= MAX_CIRCLE_RAD
        return np.asarray(np.all(np.where(self.periodic, near, inside), axis=-1))


def circles(dim: int) -> JointSpace:
    """``dim`` joints without limits."""
    return JointSpace((-np.pi,) * dim, (np.pi,) * dim, (True,) * dim)


Query = TypeVar("Query", SampleQuery, PlanQuery)


def seeded(query: Query) -> Query:
    """The query with a seed, so that a request that is sent again is the same request."""
    return query if query.seed is not None else query.model_copy(update={"seed": secrets.randbits(64)})


@dataclass(frozen=True, slots=True, eq=False)
class SampleBatch:
    """Learned samples for one picture.

    Args:
        samples: (n, d) float32 rad, circles in [-pi, pi), other joints within their limits.
        model_version: its number in the registry, 0 for a shipped model.
        round_trip_s: from the request to the answer, further attempts included.
        server_s: of the round trip, what is no transport.
        novelty: share of the training pictures that are less unusual; None where it is not known.
        acceptance: share of the proposals that reached the requested confidence.
        robot: digest of the robot, as ``GET /models`` lists it.
        confidence: (n,) float32, the validity head's score of each sample.
        request_id: under which outcomes are reported; None where no server answered.
    """

    samples: NDArray[np.float32]
    model_name: str
    model_version: int
    digest: str
    seed: int
    shortfall: int
    round_trip_s: float
    novelty: float | None = None
    server_s: float | None = None
    acceptance: float | None = None
    robot: str | None = None
    alias_confirmed: bool | None = None
    confidence: NDArray[np.float32] | None = None
    space: JointSpace | None = None
    warnings: Sequence[PictureWarning] = ()
    request_id: str | None = None

    @classmethod
    def of(cls, found: SampleAnswer, round_trip_s: float, request_id: str | None) -> Self:
        """The batch of a server's answer."""
        model = found.model
        return cls(
            samples=found.samples,
            model_name=model.name,
            model_version=model.version,
            digest=model.digest,
            seed=found.seed,
            shortfall=found.shortfall,
            round_trip_s=round_trip_s,
            novelty=found.scenario.novelty,
            server_s=1e-3 * found.timing_ms.total,
            acceptance=found.acceptance,
            robot=model.robot,
            alias_confirmed=model.alias_confirmed,
            confidence=found.confidence,
            space=JointSpace.of(found.joint_space),
            warnings=found.warnings,
            request_id=request_id,
        )


class Received(BaseModel):
    """What a client adds to an answer: the time from the request on, and the request's id."""

    round_trip_s: float = 0.0
    request_id: str | None = None


class FoundPlan(PlanAnswer, Received):
    """A path, or why there is none; the fields are those of ``POST /plan``."""


class Predictions(ValidityAnswer, Received):
    """A model's confidence in configurations; the fields are those of ``POST /validity``."""


class Diagnosis(DoctorAnswer, Received):
    """What a close look at pictures finds; the fields are those of ``POST /doctor``."""


class Belief(BeliefAnswer, Received):
    """The probability that something is in each cell of space; the fields are those of ``POST /belief``."""

    @property
    def cells(self) -> NDArray[np.float32]:
        """(X, Y, Z) the probability that a ball of the cell's width in its middle touches something."""
        packed = np.frombuffer(base64.b64decode(self.occupied), np.uint8)
        return packed.reshape(self.counts).astype(np.float32) / np.float32(255.0)

    def centres_m(self, least: float) -> NDArray[np.float64]:
        """(N, 3): middles of the cells whose probability is at least that, m, in the order of the array."""
        return np.asarray(self.low_m + self.cell_m * (np.argwhere(self.cells >= least) + 0.5))


def as_query(kind: type[Query], **values: Any) -> Query:
    """A query of keyword arguments; None counts as left out."""
    return kind(**{name: value for name, value in values.items() if value is not None})
