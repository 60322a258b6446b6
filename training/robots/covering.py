"""Few spheres that cover a solid and stick out little.

A sphere round c sticks out by no more than m where its radius is at most the depth of c plus m. So every
point of a grid through the solid, and through the shell of m / 2 around it, offers the sphere of that radius.
A greedy set cover (Chvatal 1979) takes those that cover most points left of the surface and of the inside,
until all are within the slack. A search in large neighbourhoods (Shaw 1998) then takes away spheres that
stand together and covers anew what they leave, as long as that needs no more. Points of the surface that were
drawn afresh and are missed join the others, and it goes on from there. Where no sphere of the grid reaches a
point, as at the corners of large parts, the point and others about it become centres too.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from cspace.errors import ScenarioError
from cspace.kernel_cache import njit
from training.robots.meshes import Solid, union_depth_m, union_surface

Floats = NDArray[np.float64]
Flags = NDArray[np.bool_]
Indices = NDArray[np.int64]
# Of the excess, for numbers that are written short.
_ROUNDED_M = 2e-5
# Of the slack, for what lies between the points that are looked at; the part of it that may be used up.
_RESERVE_M, _USED_M = 0.0003, 0.0002
_SURFACE_POINTS = 2000
_FRESH_POINTS = 5000
_INSIDE_POINTS = 500
_GRID_POINTS = 24_000
# Points that become centres at a time, with so many others about each.
_MORE_POINTS, _AROUND = 400, 6
_PASSES = 40
_SEARCHES = 4
_TRIES = 30
# Chosen spheres; more are of parts so large that a search changes little.
_MOST_SEARCHED = 300


@dataclass(frozen=True, slots=True)
class Allowances:
    """How far spheres may miss a solid, m.

    Args:
        slack_m: how far points of the surface may lie outside all spheres.
        excess_m: how far spheres may stick out.

    Raises:
        ScenarioError: one is below a millimetre or above a metre.
    """

    slack_m: float = 0.002
    excess_m: float = 0.010

    def __post_init__(self) -> None:
        if not all(0.001 <= one <= 1.0 for one in (self.slack_m, self.excess_m)):
            raise ScenarioError(
                "the allowances do not fit",
                expected="0.001 m or more, and at most 1 m",
                got=f"{self.slack_m}, {self.excess_m}",
            )


@dataclass(frozen=True, slots=True)
class Fit:
    """How well spheres cover a solid, measured at points that the cover was not made for.

    Args:
        spheres: how many.
        missed_m: how far the worst point of the surface lies outside all spheres; negative where none does.
        missed_share: of the surface outside all spheres.
        excess_m: how far the worst point of a sphere lies outside the solid.
        mean_excess_m: the mean of that over the surface of the spheres' union.
    """

    spheres: int
    missed_m: float
    missed_share: float
    excess_m: float
    mean_excess_m: float


class _Candidates:
    """Spheres to choose from, and which of some points each covers."""

    def __init__(self, solids: Sequence[Solid], allowances: Allowances, rng: np.random.Generator) -> None:
        self._solids, self._allowances, self._rng = solids, allowances, rng
        self._spheres = self._sound(_grid(solids, allowances.excess_m / 2.0))
        inside = self._spheres[self._spheres[:, 3] > allowances.excess_m, :3]
        some = rng.permutation(inside)[:_INSIDE_POINTS]
        self.points = np.concatenate([union_surface(solids, _SURFACE_POINTS, rng), some])
        self.covered = self.covers(self.points)
        self._reach()

    def spheres(self, chosen: Indices) -> Floats:
        return self._spheres[chosen]

    def covers(self, points: Floats, chosen: Indices | slice = slice(None)) -> Flags:
        """Which points lie in which spheres, (N, K)."""
        grown = self._spheres[chosen] + [0.0, 0.0, 0.0, self._allowances.slack_m - _RESERVE_M]
        return np.asarray(_covers(points, grown))

    def add(self, points: Floats) -> None:
        """Take more points that have to be covered."""
        self.covered = np.concatenate([self.covered, self.covers(points)])
        self.points = np.concatenate([self.points, points])
        self._reach()

    def _reach(self) -> None:
        """Take more spheres until each point is in one."""
        while len(far := self.points[~self.covered.any(axis=1)]):
            far = self._rng.permutation(far)[:_MORE_POINTS]
            steps = self._rng.normal(scale=self._allowances.excess_m, size=(len(far), _AROUND, 3))
            about = (far[:, None] + steps).reshape(-1, 3)
            first = len(self._spheres)
            self._spheres = np.concatenate([self._spheres, self._sound(about), self._sound(far)])
            more = self.covers(self.points, slice(first, None))
            self.covered = np.concatenate([self.covered, more], axis=1)

    def _sound(self, centres: Floats) -> Floats:
        """The spheres round centres that are not too far outside."""
        depths = union_depth_m(self._solids, centres)
        rows = np.column_stack([centres, depths + self._allowances.excess_m - _ROUNDED_M])
        return np.asarray(rows[depths > -self._allowances.excess_m / 2.0])


def cover(solids: Sequence[Solid], allowances: Allowances, rng: np.random.Generator) -> Floats:
    """Centres and radii of spheres that cover a union of solids, (K, 4) m."""
    candidates = _Candidates(solids, allowances, rng)
    chosen = np.empty(0, dtype=np.int64)
    for turn in range(_PASSES):
        covered, searching = candidates.covered, turn < _SEARCHES
        chosen = _without_needless(covered, _completed(covered, chosen))
        if searching and len(chosen) <= _MOST_SEARCHED:
            chosen = _improved(covered, chosen, rng)
        spheres = candidates.spheres(chosen)
        fresh = union_surface(solids, _FRESH_POINTS if searching else 4 * _FRESH_POINTS, rng)
        gaps = gaps_m(fresh, spheres)
        if not searching and gaps.max() <= allowances.slack_m - _RESERVE_M + _USED_M:
            break
        candidates.add(fresh[gaps > allowances.slack_m - _RESERVE_M])
    return spheres


def measure(solids: Sequence[Solid], spheres: Floats, rng: np.random.Generator) -> Fit:
    """How well spheres (K, 4) cover a union of solids."""
    missed = gaps_m(union_surface(solids, 2 * _FRESH_POINTS, rng), spheres)
    drawn = rng.normal(size=(len(spheres), 400, 3))
    drawn /= np.linalg.norm(drawn, axis=-1, keepdims=True)
    shells = (spheres[:, None, :3] + spheres[:, None, 3:] * drawn).reshape(-1, 3)
    shells = shells[gaps_m(shells, spheres) > -1e-9]
    excess = np.maximum(-union_depth_m(solids, shells), 0.0)
    return Fit(
        len(spheres),
        float(missed.max()),
        float(np.mean(missed > 1e-6)),
        float(excess.max()),
        float(excess.mean()),
    )


@njit(cache=True, nogil=True)
def gaps_m(points, spheres):  # type: ignore[no-untyped-def]
    """Signed distances of points (N, 3) to the union of spheres (K, 4), (N,) m."""
    out = np.full(points.shape[0], np.inf)
    for row in range(points.shape[0]):
        x, y, z = points[row]
        for one in range(spheres.shape[0]):
            dx, dy, dz = x - spheres[one, 0], y - spheres[one, 1], z - spheres[one, 2]
            out[row] = min(out[row], np.sqrt(dx * dx + dy * dy + dz * dz) - spheres[one, 3])
    return out


@njit(cache=True, nogil=True)
def _covers(points, spheres):  # type: ignore[no-untyped-def]
    out = np.empty((points.shape[0], spheres.shape[0]), dtype=np.bool_)
    for row in range(points.shape[0]):
        x, y, z = points[row]
        for one in range(spheres.shape[0]):
            dx, dy, dz = x - spheres[one, 0], y - spheres[one, 1], z - spheres[one, 2]
            out[row, one] = dx * dx + dy * dy + dz * dz <= spheres[one, 3] ** 2
    return out


def _grid(solids: Sequence[Solid], margin_m: float) -> Floats:
    bounds = np.stack([solid.mesh.bounds for solid in solids])
    low, high = bounds[:, 0].min(axis=0) - margin_m, bounds[:, 1].max(axis=0) + margin_m
    spacing = float(np.cbrt(np.prod(high - low) / _GRID_POINTS))
    axes = [
        np.linspace(a, b, max(3, int(np.ceil((b - a) / spacing)))) for a, b in zip(low, high, strict=True)
    ]
    return np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)


def _completed(covered: Flags, chosen: Indices) -> Indices:
    """Chosen spheres, with those that greed adds until every point is covered."""
    left = covered[~covered[:, chosen].any(axis=1)]
    counts = left.sum(axis=0, dtype=np.int32)
    added = list(chosen)
    while len(left):
        best = int(np.argmax(counts))
        gone = left[:, best]
        counts -= left[gone].sum(axis=0, dtype=np.int32)
        left = left[~gone]
        added.append(best)
    return np.asarray(added, dtype=np.int64)


def _improved(covered: Flags, chosen: Indices, rng: np.random.Generator) -> Indices:
    """A choice of no more spheres that covers every point, too."""
    for _ in range(_TRIES if len(chosen) > 1 else 0):
        overlap = covered[:, chosen].T.astype(np.float32)
        shared = overlap @ overlap[rng.integers(len(chosen))]
        # Those that share most with one of them, and a few by chance.
        odds = shared + 0.02 * shared.max() * rng.random(len(chosen))
        kept = np.sort(np.argsort(odds)[: -int(rng.integers(2, 8))])
        # Greed starts with a sphere by chance, or it would end where it began.
        left = covered[~covered[:, chosen[kept]].any(axis=1)]
        useful = np.flatnonzero(left.any(axis=0))
        first = rng.choice(useful, size=min(len(useful), 1))
        found = _without_needless(covered, _completed(covered, np.concatenate([chosen[kept], first])))
        if len(found) <= len(chosen):
            chosen = found
    return chosen


def _without_needless(covered: Flags, chosen: Indices) -> Indices:
    """Chosen spheres without those whose points the others cover, small ones first."""
    table = covered[:, chosen]
    times, kept = table.sum(axis=1), np.ones(len(chosen), dtype=np.bool_)
    for one in np.argsort(table.sum(axis=0)):
        if (times[table[:, one]] > 1).all():
            times -= table[:, one]
            kept[one] = False
    return chosen[kept]
