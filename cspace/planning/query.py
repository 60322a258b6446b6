"""What is asked of a planner, and what it answers. NumPy alone."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from cspace.world import NextView

Status = Literal["solved", "refused", "timeout"]
DEFAULT_WAYS = 4


@dataclass(frozen=True, slots=True)
class PlanQuery:
    """A planning problem for a scene that a picture shows.

    Args:
        start: (d,) rad.
        goal: (d,) rad.
        seed: of all draws, unsigned 64 bit.
        min_confidence: below which no way is returned, 0 to 1; None for what fits the bundle, see
            :attr:`cspace.bundle.BundleSpec.plan_confidence`.
        time_limit_s: for the search, above 0.
        ways: that are looked for, 1 or more.
        next_view: whether the camera is wanted that would see most of what the way is doubted for.
        views: cameras to choose it from, as plain values; none for some about the doubt.
        alternatives: whether all ways are wanted that are sure enough, for those who can check them.
        seen_by: cameras that the picture is from, where they are known: the next view is one from elsewhere.
    """

    start: tuple[float, ...]
    goal: tuple[float, ...]
    seed: int = 0
    min_confidence: float | None = None
    time_limit_s: float = 1.0
    ways: int = DEFAULT_WAYS
    next_view: bool = False
    views: tuple[Mapping[str, Any], ...] = ()
    alternatives: bool = False
    seen_by: tuple[Mapping[str, Any], ...] = ()


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


@dataclass(frozen=True, slots=True, eq=False)
class Plan:
    """An answer.

    Args:
        status: ``solved``; ``refused`` where no way is sure enough or none was found; ``timeout`` where none
            was found in time.
        way: (k, d) rad from start to goal, (0, d) unless it is solved.
        confidence: that the whole way touches nothing; of the surest one where it is refused, 0 without one.
        edges: (k - 1,) the least confidence of a state on each of its pieces.
        unseen: (k - 1,) the largest share of the robot on each piece that no picture shows; None in worlds
            that are seen whole.
        doubt: that its confidence is of, see :mod:`cspace.planning.scoring`; 0 without a way.
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
    confidence: float = 0.0
    edges: NDArray[np.float32] = field(default_factory=lambda: np.empty(0, dtype=np.float32))
    unseen: NDArray[np.float32] | None = None
    doubt: float = 0.0
    length_rad: float = 0.0
    found: int = 0
    least: Doubt | None = None
    next_view: NextView | None = None
    alternatives: tuple[BelievedWay, ...] = ()
    search_ms: float = 0.0
    score_ms: float = 0.0
