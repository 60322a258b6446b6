"""Topology of point clouds: the geometry score (GS) and its twin with the complement (GS-C).

Each score of a scenario comes with its noise floor, the score between two samples of the real distribution; a
score near the floor says nothing. The scores are blind to position: read them with precision and coverage.
"""

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from functools import cached_property, partial
from typing import Any

import gudhi
import numpy as np
from numpy.typing import NDArray
from scipy.spatial.distance import cdist

from cspace.kernel_cache import njit
from cspace.space import JointSpace
from services.evaluator.metrics import Task, metric
from services.evaluator.statistics import Floats, Interval, mean_interval


@dataclass(frozen=True, slots=True)
class WitnessComplex:
    """Edges (2, E) and triangles (3, T) with the relaxation at which they appear; vertices appear at 0."""

    landmarks: int
    edges: NDArray[np.int32]
    edge_values: NDArray[np.float64]
    triangles: NDArray[np.int32]
    triangle_values: NDArray[np.float64]

    def loop_intervals(self) -> NDArray[np.float64]:
        """(M, 2) birth and death of the loops (H1 over the field of two elements)."""
        tree = gudhi.SimplexTree()
        tree.insert_batch(np.arange(self.landmarks, dtype=np.int32)[None], np.zeros(self.landmarks))
        tree.insert_batch(self.edges, self.edge_values)
        tree.insert_batch(self.triangles, self.triangle_values)
        tree.compute_persistence(homology_coeff_field=2)
        return np.asarray(tree.persistence_intervals_in_dimension(1), dtype=np.float64).reshape(-1, 2)


def witness_complex(distances: NDArray[np.float64], alpha_max: float) -> WitnessComplex:
    """The complex of (N, L) distances between N witnesses and L landmarks, which are witnesses themselves.

    GUDHI's own ``WitnessComplex`` makes the same one in 120 ms instead of 6 ms (5000 points, 64 landmarks).
    ``alpha_max`` is the largest relaxation, in the units of the distances.
    """
    landmarks = distances.shape[1]
    edges, triangles = _earliest(distances, alpha_max)
    return WitnessComplex(landmarks, *_present(landmarks, edges, triangles))


@njit(cache=True, nogil=True)
def _edge(low, high):  # type: ignore[no-untyped-def]
    """Place of an edge in the list of all pairs, by the combinatorial number system."""
    return high * (high - 1) // 2 + low


@njit(cache=True, nogil=True)
def _triangle(first, second, third):  # type: ignore[no-untyped-def]
    """Place of a triangle in the list of all triples, whatever the order of its vertices."""
    low, high = min(first, second, third), max(first, second, third)
    middle = first + second + third - low - high
    return high * (high - 1) * (high - 2) // 6 + middle * (middle - 1) // 2 + low


@njit(cache=True, nogil=True)
def _nearest(row, alpha_max, indices, lengths):  # type: ignore[no-untyped-def]
    """The landmarks that a witness can use, nearest first; how many.

    No simplex has more than three vertices, so none reaches beyond the relaxation of the third nearest.
    """
    first = second = third = np.inf
    for landmark in range(row.shape[0]):
        length = row[landmark]
        if length < third:
            if length < second:
                third = second
                if length < first:
                    first, second = length, first
                else:
                    second = length
            else:
                third = length
    count = 0
    for landmark in range(row.shape[0]):
        length = row[landmark]
        if length - alpha_max <= third:
            place = count
            while place > 0 and lengths[place - 1] > length:
                lengths[place], indices[place] = lengths[place - 1], indices[place - 1]
                place -= 1
            lengths[place], indices[place] = length, landmark
            count += 1
    return count


@njit(cache=True, nogil=True)
def _earliest(distances, alpha_max):  # type: ignore[no-untyped-def]
    """Earliest relaxation of every pair and triple, its faces not asked; infinite where there is none."""
    landmarks = distances.shape[1]
    edges = np.full(landmarks * (landmarks - 1) // 2, np.inf)
    triangles = np.full(landmarks * (landmarks - 1) * (landmarks - 2) // 6, np.inf)
    near, lengths = np.empty(landmarks, dtype=np.int64), np.empty(landmarks)
    for witness in range(distances.shape[0]):
        count = _nearest(distances[witness], alpha_max, near, lengths)
        for c in range(1, count):
            for b in range(c):
                # The nearest landmark that the pair of ranks b < c leaves out, if it is nearer than c.
                omitted = lengths[0] if b > 0 else lengths[1]
                if lengths[c] - alpha_max <= omitted:
                    place = _edge(min(near[b], near[c]), max(near[b], near[c]))
                    edges[place] = min(edges[place], lengths[c] - omitted)
                for a in range(b):
                    omitted = lengths[0] if a > 0 else lengths[1] if b > 1 else lengths[2]
                    if lengths[c] - alpha_max > omitted:
                        break
                    place = _triangle(near[a], near[b], near[c])
                    triangles[place] = min(triangles[place], lengths[c] - omitted)
    return edges, triangles


@njit(cache=True, nogil=True)
def _present(landmarks, edge_values, triangle_values):  # type: ignore[no-untyped-def]
    """The simplices that appear, none before its faces."""
    edges = np.empty((2, np.isfinite(edge_values).sum()), dtype=np.int32)
    triangles = np.empty((3, np.isfinite(triangle_values).sum()), dtype=np.int32)
    appear_edges, appear_triangles = np.empty(edges.shape[1]), np.empty(triangles.shape[1])
    pairs, triples, place = 0, 0, 0
    for high in range(landmarks):
        for middle in range(high):
            side = edge_values[_edge(middle, high)]
            if np.isfinite(side):
                edges[:, pairs] = middle, high
                appear_edges[pairs] = side
                pairs += 1
            for low in range(middle):
                faces = max(side, edge_values[_edge(low, high)], edge_values[_edge(low, middle)])
                value = max(faces, triangle_values[place])
                place += 1
                if np.isfinite(value):
                    triangles[0, triples], triangles[1, triples], triangles[2, triples] = low, middle, high
                    appear_triangles[triples] = value
                    triples += 1
    return edges, appear_edges, triangles[:, :triples], appear_triangles[:triples]


LANDMARKS = 64
# As in the original experiments; with two thousand GS-C hardly tells slightly noisy samples from real ones.
POINTS = 5000
I_MAX = 100


def default_gamma(count: int) -> float:
    """Largest filtration value over the largest distance, for a cloud of ``count`` points."""
    return count / 5000.0 / 128.0


def relative_living_times(
    points: NDArray[np.floating[Any]],
    landmark_indices: NDArray[np.integer[Any]],
    gamma: float,
    i_max: int = I_MAX,
) -> Floats:
    """Shares (i_max,) of the filtration with 0, 1, 2, ... loops (H1), for one choice of landmarks.

    All (N, d) points are witnesses, and three or more of them landmarks. ``gamma`` is the largest filtration
    value over the largest distance between a point and a landmark. More loops are not counted.
    """
    distances = cdist(points, points[landmark_indices])
    alpha_max = float(distances.max()) * gamma
    return living_times(witness_complex(distances, alpha_max).loop_intervals(), alpha_max, i_max)


def living_times(intervals: NDArray[np.floating[Any]], alpha_max: float, i_max: int = I_MAX) -> Floats:
    """Living times from persistence intervals (M, 2), birth and death (equations 2 and 3).

    A death at infinity counts as ``alpha_max``, the end of the filtration.
    """
    spans = np.asarray(intervals, dtype=np.float64).reshape(-1, 2)
    spans = np.where(np.isinf(spans), alpha_max, spans)
    # Without any interval the filtration has no length to measure when all points coincide.
    if len(spans) == 0:
        return np.asarray(np.eye(1, i_max)[0])
    switches = np.unique(np.append(spans.ravel(), [0.0, alpha_max]))
    middles = (switches[1:] + switches[:-1]) / 2.0
    loops = ((middles[:, None] >= spans[:, 0]) & (middles[:, None] < spans[:, 1])).sum(axis=1)
    return np.asarray(np.bincount(loops, weights=np.diff(switches), minlength=i_max)[:i_max] / alpha_max)


def mean_living_times(
    points: NDArray[np.floating[Any]],
    rng: np.random.Generator,
    *,
    draws: int,
    gamma: float | None = None,
    landmarks: int = LANDMARKS,
) -> Floats:
    """Mean relative living times over seeded draws of landmarks (equation 4, algorithm 1)."""
    picks = [rng.choice(len(points), landmarks, replace=False) for _ in range(draws)]
    gamma = default_gamma(len(points)) if gamma is None else gamma
    return np.asarray(np.mean([relative_living_times(points, pick, gamma) for pick in picks], axis=0))


def geometry_score(first: Floats, second: Floats) -> float:
    """Sum of squared differences of two mean living times (equation 5, algorithm 2); 0 is equal."""
    return float(np.sum((first - second) ** 2))


POINTS_PER_CELL = 4.0


def occupancy(points: NDArray[np.floating[Any]], space: JointSpace) -> NDArray[np.int64]:
    """Points per cell of a regular grid inside the joint limits, (B, ..., B) for d joints.

    The cells are sized so that one holds four points on average if they were uniform.
    """
    bins = max(2, int((len(points) / POINTS_PER_CELL) ** (1.0 / space.dim)))
    ranges = list(zip(space.lower, space.upper, strict=True))
    counts, _ = np.histogramdd(np.asarray(points, dtype=np.float64), bins=bins, range=ranges)
    return counts.astype(np.int64)


def boundary_cells(counts: NDArray[np.int64], periodic: tuple[bool, ...]) -> NDArray[np.bool_]:
    """Empty cells that touch another empty cell along some joint.

    A lone empty cell is taken for chance between the points. On a circle the last cell touches the first.
    """
    empty = counts == 0
    touched = np.zeros_like(empty)
    for axis, closed in enumerate(periodic):
        for step in (-1, 1):
            neighbour = np.roll(empty, step, axis=axis)
            if not closed:
                edge = np.moveaxis(neighbour, axis, 0)
                edge[0 if step == 1 else -1] = False
            touched |= neighbour
    return np.asarray(empty & touched)


def sample_complement(
    points: NDArray[np.floating[Any]], space: JointSpace, rng: np.random.Generator, count: int
) -> NDArray[np.float64]:
    """``count`` configurations (count, d) rad from the regions that the points leave empty, weighted by area.

    There are none when no region is empty.
    """
    counts = occupancy(points, space)
    cells = np.argwhere(boundary_cells(counts, space.periodic))
    if len(cells) == 0:
        return np.empty((0, space.dim))
    low, high = np.asarray(space.lower), np.asarray(space.upper)
    # All cells have the same area, so drawing them evenly weights every region by its own.
    corners = cells[rng.integers(0, len(cells), size=count)]
    return np.asarray(low + (corners + rng.random((count, space.dim))) * (high - low) / len(counts))


QUARTER_TURNS = 4


def square_to_disk(square: NDArray[np.floating[Any]]) -> NDArray[np.float64]:
    """The elliptical map from [-1, 1]^2 onto the unit disk, (N, 2) to (N, 2)."""
    x, y = square[:, 0], square[:, 1]
    return np.stack([x * np.sqrt(1.0 - y * y / 2.0), y * np.sqrt(1.0 - x * x / 2.0)], axis=1)


def quarter_turn(points: NDArray[np.float64], turns: int) -> NDArray[np.float64]:
    """(N, 2) rotated counter-clockwise by ``turns`` quarters of a circle, exactly."""
    x, y = points[:, 0], points[:, 1]
    return np.stack([(x, y), (-y, x), (-x, -y), (y, -x)][turns % QUARTER_TURNS], axis=1)


def enlarged_turns(
    configurations: NDArray[np.floating[Any]], space: JointSpace
) -> Iterator[NDArray[np.float64]]:
    """The four enlarged disks of (N, 2) configurations, each (N, 2)."""
    low, high = np.asarray(space.lower), np.asarray(space.upper)
    disk = square_to_disk(2.0 * (configurations - low) / (high - low) - 1.0)
    for turns in range(QUARTER_TURNS):
        yield np.exp(quarter_turn(disk, turns))


# Mean living times of one cloud, of its four turns for two joints and of the cloud as it is for others.
TurnedTimes = tuple[Floats, ...]


def turned_living_times(
    configurations: NDArray[np.floating[Any]], space: JointSpace, rng: np.random.Generator, *, draws: int
) -> TurnedTimes:
    """Mean living times of (N, d) configurations: on the four enlarged disks for d = 2, else as they are.

    An empty cloud (the complement of one that fills the joint space) has no loop at any time.
    """
    planar = space.dim == 2
    if len(configurations) == 0:
        return (np.eye(1, I_MAX)[0],) * (QUARTER_TURNS if planar else 1)
    clouds = enlarged_turns(configurations, space) if planar else (configurations,)
    return tuple(mean_living_times(cloud, rng, draws=draws) for cloud in clouds)


def largest_score(first: TurnedTimes, second: TurnedTimes) -> float:
    """Largest geometry score over the turns."""
    return max(geometry_score(a, b) for a, b in zip(first, second, strict=True))


def complement_score(
    first: TurnedTimes, second: TurnedTimes, first_complement: TurnedTimes, second_complement: TurnedTimes
) -> float:
    """GS-C of two clouds with their complements; 0 is equal."""
    both = largest_score(first, second) + largest_score(first_complement, second_complement)
    return both / (2.0 * (I_MAX - 1))


@dataclass(frozen=True)
class Clouds:
    """Samples of a model, and two times as many real ones, in one scenario.

    ``rng`` makes the scenario's generator of a number; ``collisions`` samples so many colliding states.
    """

    real: Floats
    generated: Floats
    again: Floats
    space: JointSpace
    draws: int
    rng: Callable[[int], np.random.Generator]
    collisions: Callable[[int, np.random.Generator], Floats]

    @cached_property
    def complement_scores(self) -> tuple[tuple[float, float], tuple[float, float]]:
        """GS-C and its floor, the real side's complement from the points, then from its collision states."""
        space, count, rng = self.space, len(self.real), self.rng(6)
        clouds = (self.real, self.generated, self.again)

        def turned(cloud: Floats) -> TurnedTimes:
            return turned_living_times(cloud, space, rng, draws=self.draws)

        real, ours, again = (turned(cloud) for cloud in clouds)
        real_c, ours_c, again_c = (turned(sample_complement(c, space, rng, count)) for c in clouds)
        collisions = self.collisions(count, rng)
        # Fewer collision states than landmarks in a hundred thousand draws: no obstacle to speak of.
        true_c = turned(collisions if len(collisions) >= LANDMARKS else collisions[:0])
        boundary, true = (
            (complement_score(real, ours, c, ours_c), complement_score(real, again, c, again_c))
            for c in (real_c, true_c)
        )
        return boundary, true


def _with_floor(name: str, values: Floats, _: Floats, rng: np.random.Generator) -> Mapping[str, Interval]:
    return {name: mean_interval(values[:, 0], rng), f"{name}_floor": mean_interval(values[:, 1], rng)}


@metric("gs", Task.TOPOLOGY, estimates=partial(_with_floor, "gs"))
def gs(clouds: Clouds) -> tuple[float, float]:
    """The geometry score and its noise floor."""
    rng = clouds.rng(5)
    real, generated, again = (
        mean_living_times(cloud, rng, draws=clouds.draws)
        for cloud in (clouds.real, clouds.generated, clouds.again)
    )
    return geometry_score(real, generated), geometry_score(real, again)


@metric("gsc_boundary", Task.TOPOLOGY, estimates=partial(_with_floor, "gsc_boundary"))
def gsc_boundary(clouds: Clouds) -> tuple[float, float]:
    """GS-C and its floor, both complements from the points."""
    return clouds.complement_scores[0]


@metric("gsc_true", Task.TOPOLOGY, estimates=partial(_with_floor, "gsc_true"))
def gsc_true(clouds: Clouds) -> tuple[float, float]:
    """GS-C and its floor, the real side's complement from its collision states."""
    return clouds.complement_scores[1]
