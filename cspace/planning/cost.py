"""The cost of paths, -log P along them, and how confident a model is of their states, pieces and whole."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from importlib import import_module

import numpy as np
from numpy.typing import NDArray

from cspace.planning.paths import length_rad, spaced
from cspace.query import AlternativePath, LeastConfidence
from cspace.space import JointSpace

# (n, d) float32 rad to P(free) (n,) and to the share of the robot in unseen space (n,), or None.
Predict = Callable[[NDArray[np.float32]], tuple[NDArray[np.float32], NDArray[np.float32] | None]]
_LEAST = 1e-6
# Of an exponent; e to that is no chance any more.
_MOST = 20.0
# Of confidence, beside what is true.
_BINS = 10
# Euclidean distance from an end that is known to be free at which that says nothing any more.
FREE_RAD = 0.5


@dataclass(frozen=True, slots=True, eq=False)
class ScoredPath:
    """A path and what a model predicts for it."""

    path: NDArray[np.float64]  # (k, d) rad
    states: NDArray[np.float64]  # (n, d) rad along it, both ends included
    pieces: NDArray[np.int64]  # (n,) the piece that each state lies on, 0 to k - 2
    confidence: NDArray[np.float32]  # (n,) of each state
    unseen: NDArray[np.float32] | None  # (n,) share of the robot that no picture shows
    length_rad: float  # Euclidean
    plan_calibration: tuple[float, float] = (0.0, 1.0)

    @property
    def costs(self) -> NDArray[np.float64]:
        """(n,): -log P of each state."""
        return costs_of(self.confidence)

    @property
    def cost(self) -> float:
        """Integral of -log P along the path in rad, and its largest value."""
        return float(self.costs.mean() * self.length_rad + self.costs.max()) if len(self.states) else 0.0

    @property
    def whole(self) -> float:
        """Confidence of the whole path."""
        return float(confidence_of_cost(np.array(self.cost), self.plan_calibration))

    def alternative(self) -> AlternativePath:
        """The path with the confidence of it and its pieces."""
        return AlternativePath(self.path, self.whole, self.of_pieces(self.confidence, np.minimum))

    def least(self) -> LeastConfidence:
        """Its state of lowest confidence."""
        at = int(np.argmin(self.confidence))
        unseen = None if self.unseen is None else float(self.unseen[at])
        return LeastConfidence(
            self.states[at], float(self.confidence[at]), unseen, at / max(1, len(self.states) - 1)
        )

    def of_pieces(self, values: NDArray[np.float32], pick: np.ufunc) -> NDArray[np.float32]:
        """The least (``np.minimum``) or largest (``np.maximum``) value on each piece, its ends included."""
        count = len(self.path) - 1
        found = np.full(count, np.inf if pick is np.minimum else -np.inf, dtype=np.float32)
        pick.at(found, self.pieces, values)
        # A corner belongs to both its pieces.
        corners = np.flatnonzero(np.diff(self.pieces))
        pick.at(found, self.pieces[corners + 1], values[corners])
        return found


def costs_of(confidence: NDArray[np.float32]) -> NDArray[np.float64]:
    """-log P of states (n,), (n,); finite."""
    return np.asarray(-np.log(np.clip(confidence, _LEAST, 1.0)), dtype=np.float64)


def confidence_of_cost(
    cost: NDArray[np.float64], plan_calibration: tuple[float, float]
) -> NDArray[np.float64]:
    """How likely paths of a cost (n,) are free, (n,); 1 without cost."""
    offset, slope = plan_calibration
    with np.errstate(divide="ignore"):
        return np.asarray(np.exp(-np.exp(np.minimum(offset + slope * np.log(cost), _MOST))))


def fit_calibration(
    cost: NDArray[np.float64],
    free: NDArray[np.bool_],
    prior: float = 4.0,
    usual: tuple[float, float] = (0.0, 1.0),
) -> tuple[float, float]:
    """(a, b) by which paths of a cost D are free with exp(-exp(a + b log D)), by maximum likelihood.

    ``cost``: (n,), not negative. ``free``: (n,). ``prior``: precision, halved, of a normal prior of a and b
    at ``usual``, of which (0, 1) leaves the cost as it is.
    """
    # By name: who only reads bundles has no scipy.
    minimize = import_module("scipy.optimize").minimize
    cost = np.maximum(cost, _LEAST)

    def loss(parameters: NDArray[np.float64]) -> float:
        confidence = confidence_of_cost(cost, (parameters[0], parameters[1]))
        confidence = np.clip(confidence, _LEAST, 1.0 - _LEAST)
        pull = prior * ((parameters[0] - usual[0]) ** 2 + (parameters[1] - usual[1]) ** 2)
        return float(pull - np.where(free, np.log(confidence), np.log1p(-confidence)).sum())

    found = minimize(loss, np.array(usual), method="L-BFGS-B", bounds=[(-10.0, 10.0), (0.05, 10.0)])
    return float(found.x[0]), float(found.x[1])


def calibration_error(confidence: NDArray[np.float64], free: Sequence[bool] | NDArray[np.bool_]) -> float:
    """Mean distance of confidence (n,) and truth (n,) over ten bins of the confidence."""
    place = np.minimum((np.asarray(confidence) * _BINS).astype(int), _BINS - 1)
    return float(np.abs(np.bincount(place, confidence - np.asarray(free), _BINS)).sum() / len(confidence))


def given_free(predict: Predict, space: JointSpace, ends: NDArray[np.float64]) -> Predict:
    """``predict`` of a robot that is known to be free at ``ends`` (k, d) rad: doubt grows from there on."""

    def conditioned(rows: NDArray[np.float32]) -> tuple[NDArray[np.float32], NDArray[np.float32] | None]:
        confidence, unseen = predict(rows)
        share = np.minimum(space.distance(ends[:, None], rows[None]).min(axis=0) / FREE_RAD, 1.0)
        return (1.0 - share * (1.0 - confidence)).astype(np.float32), unseen

    return conditioned


def score(
    paths: Sequence[NDArray[np.float64]],
    space: JointSpace,
    step_rad: float,
    predict: Predict,
    plan_calibration: tuple[float, float] = (0.0, 1.0),
) -> list[ScoredPath]:
    """What is predicted for paths, in one call; states are at most ``step_rad`` apart."""
    if not paths:
        return []
    rows, pieces = zip(*(_states(path, space, step_rad) for path in paths), strict=True)
    confidence, unseen = predict(space.to_float32(np.concatenate(rows)))
    ends = np.cumsum([len(one) for one in rows])[:-1]
    confidences = np.split(confidence, ends)
    hidden = [None] * len(paths) if unseen is None else np.split(unseen, ends)
    return [
        ScoredPath(path, states, numbers, one, other, length_rad(path, space), plan_calibration)
        for path, states, numbers, one, other in zip(paths, rows, pieces, confidences, hidden, strict=True)
    ]


def _states(
    path: NDArray[np.float64], space: JointSpace, step_rad: float
) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    parts = [spaced(path[index : index + 2], space, step_rad) for index in range(len(path) - 1)]
    rows = [parts[0], *(part[1:] for part in parts[1:])]
    return np.concatenate(rows), np.repeat(np.arange(len(rows)), [len(part) for part in rows])
