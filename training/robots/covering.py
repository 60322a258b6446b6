"""Few spheres that cover a solid and stick out little.

A sphere round c sticks out by no more than m where its radius is at most the depth of c plus m. So every
point of a grid through the solid, and through the shell of m / 2 around it, offers the sphere of that radius.
A greedy set cover (Chvatal 1979) takes those that cover most points left of the surface and of the inside,
until all are within the slack. A search in large neighbourhoods (Shaw 1998) then takes away spheres that
stand together and covers anew what they leave, as long as that needs no more. Points of the surface that were
drawn afresh and are missed join the others, and it goes on from there.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from cspace.errors import ScenarioError
from training.robots.meshes import Mesh

Floats = NDArray[np.float64]
Flags = NDArray[np.bool_]
Indices = NDArray[np.int64]
# Of the excess, for numbers that are written short.
_ROUNDED_M = 2e-5
# Of the slack, for what lies between the points that are looked at.
_RESERVE_M = 0.0002
_SURFACE_POINTS = 2000
_FRESH_POINTS = 20_000
_INSIDE_POINTS = 500
_GRID_POINTS = 24_000
_PASSES = 20
_SEARCHES = 4
_TRIES = 30
_CHUNK = 500
# That are held against all spheres of the grid; thin shapes and fine meshes have many edges.
_MAX_POINTS = 40_000


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


def depth_m(solid: Sequence[Mesh], points: Floats) -> Floats:
    """Depth of each of (N, 3) in the union of meshes, (N,) m; negative outside, and no deeper than in one."""
    return np.asarray(np.max([mesh.depth_m(points) for mesh in solid], axis=0))


def cover(solid: Sequence[Mesh], allowances: Allowances, rng: np.random.Generator) -> Floats:
    """Centres and radii of spheres that cover a union of meshes, (K, 4) m.

    Raises:
        ScenarioError: the allowances are too small for the points that are looked at.
    """
    centres, depths = _grid(solid, allowances)
    radii = depths + allowances.excess_m - _ROUNDED_M
    grown = np.column_stack([centres, radii + allowances.slack_m - _RESERVE_M])
    inside = np.flatnonzero(depths > 0.0)
    inside = rng.choice(inside, size=min(len(inside), _INSIDE_POINTS), replace=False)
    points = np.concatenate([_surface(solid, _SURFACE_POINTS, rng), centres[inside]])
    if len(points) > _MAX_POINTS:
        # The rest are drawn afresh below, where they are missed.
        points = rng.choice(points, size=_MAX_POINTS, replace=False)
    covered, chosen = _covered(points, grown), np.empty(0, dtype=np.int64)
    for turn in range(_PASSES):
        if not covered.any(axis=1).all():
            raise ScenarioError(
                "the spheres do not cover the robot",
                expected="allowances that its thin parts leave room for",
                got=f"{int((~covered.any(axis=1)).sum())} points without a sphere",
                remedy="raise --slack-mm or --excess-mm",
            )
        chosen, searching = _without_needless(covered, _completed(covered, chosen)), turn < _SEARCHES
        chosen = _improved(covered, chosen, rng) if searching else chosen
        fresh = _surface(solid, _FRESH_POINTS if searching else 5 * _FRESH_POINTS, rng)
        missed = fresh[~_covered(fresh, grown[chosen]).any(axis=1)]
        if not searching and not len(missed):
            break
        covered = np.concatenate([covered, _covered(missed, grown)])
    return np.column_stack([centres[chosen], radii[chosen]])


def measure(solid: Sequence[Mesh], spheres: Floats, rng: np.random.Generator) -> Fit:
    """How well spheres (K, 4) cover a union of meshes."""
    surface = _surface(solid, _FRESH_POINTS, rng)
    missed = _gaps(surface, spheres).min(axis=1)
    drawn = rng.normal(size=(len(spheres), 400, 3))
    drawn /= np.linalg.norm(drawn, axis=-1, keepdims=True)
    shells = (spheres[:, None, :3] + spheres[:, None, 3:] * drawn).reshape(-1, 3)
    shells = shells[_gaps(shells, spheres).min(axis=1) > -1e-9]
    excess = np.maximum(-depth_m(solid, shells), 0.0)
    return Fit(
        len(spheres),
        float(missed.max()),
        float(np.mean(missed > 1e-6)),
        float(excess.max()),
        float(excess.mean()),
    )


def _grid(solid: Sequence[Mesh], allowances: Allowances) -> tuple[Floats, Floats]:
    corners = np.concatenate([mesh.corners.reshape(-1, 3) for mesh in solid])
    margin = allowances.excess_m / 2.0
    low, high = corners.min(axis=0) - margin, corners.max(axis=0) + margin
    spacing = float(np.cbrt(np.prod(high - low) / _GRID_POINTS))
    axes = [
        np.linspace(a, b, max(3, int(np.ceil((b - a) / spacing)))) for a, b in zip(low, high, strict=True)
    ]
    points = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
    depths = depth_m(solid, points)
    near = depths > -margin
    return points[near], depths[near]


def _surface(solid: Sequence[Mesh], count: int, rng: np.random.Generator) -> Floats:
    """Points of the surface of the union, about so many."""
    area = sum(float(mesh.areas_m2.sum()) for mesh in solid)
    spacing = float(np.sqrt(area / count))
    found = []
    for index, mesh in enumerate(solid):
        points = mesh.surface(spacing, rng)
        others = [*solid[:index], *solid[index + 1 :]]
        found.append(points[depth_m(others, points) < 1e-6] if others else points)
    return np.concatenate(found)


def _gaps(points: Floats, spheres: Floats) -> Floats:
    """Signed distances of (N, 3) to (K, 4), (N, K)."""
    squares = (points**2).sum(axis=1)[:, None] + (spheres[:, :3] ** 2).sum(axis=1)
    squares -= 2.0 * points @ spheres[:, :3].T
    return np.asarray(np.sqrt(np.maximum(squares, 0.0)) - spheres[:, 3])


def _covered(points: Floats, spheres: Floats) -> Flags:
    """Which points are covered by which spheres, (N, K)."""
    result = np.empty((len(points), len(spheres)), dtype=np.bool_)
    for first in range(0, len(points), _CHUNK):
        result[first : first + _CHUNK] = _gaps(points[first : first + _CHUNK], spheres) <= 0.0
    return result


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
