"""Topology of point clouds: the geometry score (GS) and its twin with the complement (GS-C).

Each score of a scenario comes with its noise floor, the score between two samples of the real distribution; a
score near the floor says nothing. The scores are blind to position: read them with precision and coverage.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import gudhi
import numpy as np
from numpy.typing import NDArray
from scipy.spatial.distance import cdist

from cspace.errors import EvaluationError
from cspace.kernel_cache import njit
from cspace.space import JointSpace
from services.evaluator.measures.scenes import Scene, unfiltered
from services.evaluator.statistics import Interval, mean_interval
from services.planner.samples import SampleSource


@dataclass(frozen=True, slots=True)
class WitnessComplex:
    """Edges and triangles with the relaxation at which they appear; every vertex appears at 0.

    Args:
        landmarks: number of vertices.
        edges: (2, E) vertices.
        edge_values: (E,) relaxations.
        triangles: (3, T) vertices.
        triangle_values: (T,) relaxations.
    """

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

    Args:
        distances: L is three or more.
        alpha_max: largest relaxation, in the units of the distances.
    """
    landmarks = distances.shape[1]
    edges, triangles = _earliest(distances, alpha_max)
    parts = _present(landmarks, edges, triangles)
    return WitnessComplex(landmarks, *parts)


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
# A triangle has as many.
FEWEST_LANDMARKS = 3


@dataclass(frozen=True, slots=True)
class RelativeLivingTimes:
    """How long each number of loops lives.

    Args:
        values: (i_max,) share of the filtration with 0, 1, 2, ... loops.
        remainder: share with ``i_max`` loops or more; values and remainder sum to one.
    """

    values: NDArray[np.float64]
    remainder: float


def default_gamma(count: int) -> float:
    """Largest filtration value over the largest distance, for a cloud of ``count`` points."""
    return count / 5000.0 / 128.0


def relative_living_times(
    points: NDArray[np.floating[Any]],
    landmark_indices: NDArray[np.integer[Any]],
    gamma: float,
    i_max: int = I_MAX,
) -> RelativeLivingTimes:
    """Relative living times of loops (H1) for one choice of landmarks.

    Args:
        points: (N, d), all of them witnesses, in any number of dimensions.
        landmark_indices: (L,) rows of ``points``.
        gamma: largest filtration value over the largest distance between a point and a landmark.
        i_max: number of loops from which on they are counted together.

    Raises:
        EvaluationError: no points, points that are not finite, too few landmarks, or gamma not above 0.
    """
    if points.ndim != 2 or len(points) == 0 or len(landmark_indices) < FEWEST_LANDMARKS or not gamma > 0.0:
        raise EvaluationError(
            "no witness complex can be built",
            expected=f"points (N, d), {FEWEST_LANDMARKS} landmarks or more, gamma above 0",
            got=f"points {points.shape}, {len(landmark_indices)} landmarks, gamma {gamma}",
        )
    distances = cdist(points, points[landmark_indices])
    alpha_max = float(distances.max()) * gamma
    if not np.isfinite(alpha_max):
        raise EvaluationError("no witness complex can be built", expected="finite points", got="nan or inf")
    return living_times(witness_complex(distances, alpha_max).loop_intervals(), alpha_max, i_max)


def living_times(
    intervals: NDArray[np.floating[Any]], alpha_max: float, i_max: int = I_MAX
) -> RelativeLivingTimes:
    """Living times from persistence intervals (equations 2 and 3).

    Args:
        intervals: (M, 2) birth and death; a death at infinity counts as ``alpha_max``.
        alpha_max: end of the filtration.
        i_max: number of loops from which on they are counted together.
    """
    spans = np.asarray(intervals, dtype=np.float64).reshape(-1, 2)
    spans = np.where(np.isinf(spans), alpha_max, spans)
    # Without any interval the filtration has no length to measure when all points coincide.
    if len(spans) == 0:
        return RelativeLivingTimes(np.eye(1, i_max)[0], 0.0)
    switches = np.unique(np.append(spans.ravel(), [0.0, alpha_max]))
    middles = (switches[1:] + switches[:-1]) / 2.0
    loops = ((middles[:, None] >= spans[:, 0]) & (middles[:, None] < spans[:, 1])).sum(axis=1)
    shares = np.bincount(loops, weights=np.diff(switches), minlength=i_max) / alpha_max
    return RelativeLivingTimes(shares[:i_max], float(shares[i_max:].sum()))


def mean_living_times(
    points: NDArray[np.floating[Any]],
    rng: np.random.Generator,
    *,
    draws: int,
    gamma: float | None = None,
    landmarks: int = LANDMARKS,
    i_max: int = I_MAX,
) -> RelativeLivingTimes:
    """Mean relative living times over seeded draws of landmarks (equation 4, algorithm 1).

    Raises:
        EvaluationError: fewer points than landmarks, or no draws.
    """
    if len(points) < landmarks or draws < 1:
        raise EvaluationError(
            "living times need points and draws",
            expected=f"{landmarks} points and one draw or more",
            got=f"{len(points)} points, {draws} draws",
        )
    picks = [rng.choice(len(points), landmarks, replace=False) for _ in range(draws)]
    gamma = default_gamma(len(points)) if gamma is None else gamma
    times = [relative_living_times(points, pick, gamma, i_max) for pick in picks]
    values = np.mean([t.values for t in times], axis=0)
    return RelativeLivingTimes(values, float(np.mean([t.remainder for t in times])))


def geometry_score(first: RelativeLivingTimes, second: RelativeLivingTimes) -> float:
    """Sum of squared differences of two mean living times (equation 5, algorithm 2); 0 is equal."""
    return float(np.sum((first.values - second.values) ** 2))


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
    points: NDArray[np.floating[Any]],
    space: JointSpace,
    rng: np.random.Generator,
    count: int,
) -> NDArray[np.float64]:
    """``count`` configurations from the regions that the points leave empty, weighted by area.

    Returns:
        (count, d) rad, or (0, d) when no region is empty.
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
    """The four enlarged disks of (N, 2) configurations, each (N, 2).

    Raises:
        EvaluationError: the joint space has not two dimensions.
    """
    if space.dim != 2:
        raise EvaluationError(
            "the disk map is for two joints", expected="2", got=str(space.dim), remedy="use the plain score"
        )
    low, high = np.asarray(space.lower), np.asarray(space.upper)
    disk = square_to_disk(2.0 * (configurations - low) / (high - low) - 1.0)
    for turns in range(QUARTER_TURNS):
        yield np.exp(quarter_turn(disk, turns))


# Mean living times of one cloud, of its four turns for two joints and of the cloud as it is for others.
TurnedTimes = tuple[RelativeLivingTimes, ...]


def turned_living_times(
    configurations: NDArray[np.floating[Any]],
    space: JointSpace,
    rng: np.random.Generator,
    *,
    draws: int,
) -> TurnedTimes:
    """Mean living times of (N, d) configurations: on the four enlarged disks for d = 2, else as they are.

    An empty cloud (the complement of one that fills the joint space) has no loop at any time.

    Raises:
        EvaluationError: points, but fewer than landmarks.
    """
    planar = space.dim == 2
    if len(configurations) == 0:
        none = RelativeLivingTimes(np.eye(1, I_MAX)[0], 0.0)
        return (none,) * (QUARTER_TURNS if planar else 1)
    if len(configurations) < LANDMARKS:
        raise EvaluationError(
            "the cloud is too small", expected=f"{LANDMARKS} points", got=str(len(configurations))
        )
    clouds = enlarged_turns(configurations, space) if planar else (configurations,)
    return tuple(mean_living_times(cloud, rng, draws=draws) for cloud in clouds)


def largest_score(first: TurnedTimes, second: TurnedTimes) -> float:
    """Largest geometry score over the turns.

    Raises:
        EvaluationError: one cloud has been turned and the other has not.
    """
    if len(first) != len(second):
        raise EvaluationError(
            "the clouds differ in their turns", expected=str(len(first)), got=str(len(second))
        )
    return max(geometry_score(a, b) for a, b in zip(first, second, strict=True))


def complement_score(
    first: TurnedTimes,
    second: TurnedTimes,
    first_complement: TurnedTimes,
    second_complement: TurnedTimes,
) -> float:
    """GS-C of two clouds with their complements; 0 is equal.

    Raises:
        EvaluationError: clouds of two joints and of another number.
    """
    both = largest_score(first, second) + largest_score(first_complement, second_complement)
    return both / (2.0 * (I_MAX - 1))


Cloud = NDArray[np.float64]
SCORES = ("gs", "gsc_boundary", "gsc_true")


@dataclass(frozen=True, slots=True)
class Scored:
    """A score of the sampler beside the score of further real samples."""

    score: float
    floor: float


@dataclass(frozen=True, slots=True)
class SceneTopology:
    """Topology of one scenario.

    Args:
        index: the scenario's number within its split.
        gs: geometry score.
        gsc_boundary: GS-C, the complements of both sides by the boundary algorithm; without the turns where
            there are not two joints.
        gsc_true: GS-C, the real side's complement from its true collision states; likewise.
        remainder: largest share of living time with too many loops to be counted.
    """

    index: int
    gs: Scored
    gsc_boundary: Scored
    gsc_true: Scored
    remainder: float


@dataclass(frozen=True, slots=True)
class ScoreSummary:
    """A score and its floor, over scenarios or over the repeats of one."""

    score: Interval
    floor: Interval


def scene_topology(
    scene: Scene,
    sampler: SampleSource,
    draws: int,
    samples: int = POINTS,
) -> SceneTopology:
    """GS and GS-C of a sampler on one scenario.

    Args:
        scene: the scenario.
        sampler: under test.
        draws: of landmarks, per cloud and turn.
        samples: points per cloud.
    """
    seed = int(scene.rng(11).integers(0, 2**63))
    generated = unfiltered(sampler, scene.image, samples, seed)
    real, again = (scene.free(samples, scene.rng(stream)) for stream in (3, 4))
    clouds = (real, generated, again)
    rng = scene.rng(5)
    times = [mean_living_times(cloud, rng, draws=draws) for cloud in clouds]
    plain = Scored(geometry_score(times[0], times[1]), geometry_score(times[0], times[2]))
    boundary, true = _complement_scores(scene, clouds, scene.rng(6), draws)
    return SceneTopology(scene.index, plain, boundary, true, max(one.remainder for one in times))


def summarise_topology(scenes: Sequence[SceneTopology], rng: np.random.Generator) -> dict[str, ScoreSummary]:
    """Means of every score that was taken, with intervals over scenarios.

    Raises:
        EvaluationError: no scenarios.
    """
    summary = {}
    for name in SCORES:
        rows = [getattr(scene, name) for scene in scenes]
        scores, floors = [row.score for row in rows], [row.floor for row in rows]
        summary[name] = ScoreSummary(mean_interval(scores, rng), mean_interval(floors, rng))
    return summary


def _complement_scores(
    scene: Scene, clouds: tuple[Cloud, Cloud, Cloud], rng: np.random.Generator, draws: int
) -> tuple[Scored, Scored]:
    """GS-C with the real side's complement by the boundary algorithm, and with its true collision states."""
    count = len(clouds[0])

    def turned(cloud: Cloud) -> TurnedTimes:
        return turned_living_times(cloud, scene.space, rng, draws=draws)

    real, ours, again = (turned(cloud) for cloud in clouds)
    real_c, ours_c, again_c = (turned(sample_complement(c, scene.space, rng, count)) for c in clouds)
    collisions = scene.collisions(count, rng)
    # Fewer collision states than landmarks in a hundred thousand draws: no obstacle to speak of.
    true_c = turned(collisions if len(collisions) >= LANDMARKS else collisions[:0])
    return (
        Scored(complement_score(real, ours, real_c, ours_c), complement_score(real, again, real_c, again_c)),
        Scored(complement_score(real, ours, true_c, ours_c), complement_score(real, again, true_c, again_c)),
    )
