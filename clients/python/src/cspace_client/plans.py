"""What is asked of the API's planner, and what it answers."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal, Protocol

import numpy as np
from numpy.typing import NDArray

from cspace_client.model import ModelHead

Status = Literal["solved", "refused", "timeout"]


class PlanWanted(Protocol):
    """What is asked of a planner; :class:`PlanQuery`, or any value with the same members."""

    @property
    def start(self) -> Sequence[float]:
        """(d,) rad."""

    @property
    def goal(self) -> Sequence[float]:
        """(d,) rad."""

    @property
    def seed(self) -> int:
        """Of all draws, unsigned 64 bit."""

    @property
    def min_confidence(self) -> float | None:
        """Below which no way is returned; None for the server's own."""

    @property
    def time_limit_s(self) -> float | None:
        """For the search; None for the server's own."""

    @property
    def ways(self) -> int | None:
        """That are looked for; None for the server's own number."""

    @property
    def next_view(self) -> bool:
        """Whether a camera is wanted that would see more."""

    @property
    def views(self) -> Sequence[Mapping[str, Any]]:
        """Cameras to choose it from."""

    @property
    def alternatives(self) -> bool:
        """Whether all ways are wanted that are sure enough."""


@dataclass(frozen=True, slots=True)
class PlanQuery:
    """A planning problem for a scene that a picture shows; the server judges its ranges.

    Args:
        start: (d,) rad.
        goal: (d,) rad.
        seed: of all draws, unsigned 64 bit.
        min_confidence: below which no way is returned, 0 to 1; None for the server's own.
        time_limit_s: for the search; None for the server's own.
        ways: that are looked for; None for the server's own number.
        next_view: whether the camera is wanted that would see most of what the way is doubted for.
        views: cameras to choose it from, as plain values; none for some about the doubt.
        alternatives: whether all ways are wanted that are sure enough, for those who can check them.
    """

    start: Sequence[float]
    goal: Sequence[float]
    seed: int = 0
    min_confidence: float | None = None
    time_limit_s: float | None = None
    ways: int | None = None
    next_view: bool = False
    views: Sequence[Mapping[str, Any]] = ()
    alternatives: bool = False


@dataclass(frozen=True, slots=True, eq=False)
class Doubt:
    """Where a way is least sure.

    Args:
        configuration: (d,) rad.
        confidence: of it alone.
        unseen: share of the robot that no picture shows there; None in worlds that are seen whole.
        along: how far along the way it lies, 0 to 1.
    """

    configuration: NDArray[np.float64]
    confidence: float
    unseen: float | None
    along: float


@dataclass(frozen=True, slots=True, eq=False)
class BelievedWay:
    """A way and how sure a model is of it.

    Args:
        way: (k, d) rad from start to goal.
        confidence: that the whole way touches nothing.
        edges: (k - 1,) the least confidence of a state on each of its pieces.
    """

    way: NDArray[np.float64]
    confidence: float
    edges: NDArray[np.float32]


@dataclass(frozen=True, slots=True)
class NextView:
    """A camera that would see more.

    Args:
        camera: as plain values.
        sees: share of the doubt along a way that lies on space it would see, 0 to 1.
    """

    camera: Mapping[str, Any]
    sees: float


@dataclass(frozen=True, slots=True, eq=False)
class Plan:
    """A way, or none.

    Args:
        status: ``solved``; ``refused`` where no way is sure enough or none was found; ``timeout`` where none
            was found in time.
        way: (k, d) rad from start to goal, (0, d) unless it is solved.
        confidence: that the whole way touches nothing; of the surest one where it is refused, 0 without one.
        edges: (k - 1,) the least confidence of a state on each of its pieces.
        unseen: (k - 1,) the largest share of the robot on each piece that no picture shows; None in worlds
            that are seen whole.
        length_rad: Euclidean.
        found: ways that the best was chosen from.
        least: where the surest way is least sure; None without one.
        next_view: the camera that would see most of what that way is doubted for; None where none was asked
            for, or none would see more.
        alternatives: all ways that are sure enough, the surest first, which is the plan's; none where they
            were not asked for.
        search_ms: looking for ways.
        score_ms: asking the model about them.
    """

    status: Status
    way: NDArray[np.float64]
    confidence: float
    edges: NDArray[np.float32]
    unseen: NDArray[np.float32] | None
    length_rad: float
    found: int
    least: Doubt | None
    next_view: NextView | None
    alternatives: tuple[BelievedWay, ...]
    search_ms: float
    score_ms: float


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
