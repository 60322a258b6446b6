"""Samples for a request: a seed's random numbers, rejection sampling, and the two samplers.

What is random comes from one generator in a fixed order, which decides what a seed means:

1. ``rng = Generator(PCG64(SeedSequence(seed)))``; for a further turn, which samples what the ones before left
   missing or put outside the robot's limits, ``SeedSequence(seed, spawn_key=(turn,))`` with turn = 1, 2, ...
2. eta, standard normal float32 (m, L), for all m latents of the request at once.
3. Every random input of the description in its order there, float32 (m, *shape), for all latents at once:
   standard normal, or low + (high - low) * u with u uniform in [0, 1).

The latents of the first value of the epsilon schedule come first, then those of the second, and so on; each
value gets ceil(share / K) of them, and the last one's surplus samples are left out. Of the proposals of a
request that filters, a quarter (:data:`UNIFORM_SHARE`) is uniform over the joint space, for coverage, by a
generator of its own: ``SeedSequence(seed, spawn_key=(turn, 1))``, first u uniform in [0, 1) for every sample,
uniform where u < share, then d angles for each of these. Path models have no uniform proposals.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from cspace.bundle.runtime import CHUNK_ROWS, PATH_CHUNK_ROWS, Graph, chunked
from cspace.bundle.spec import MAP, PICTURE, BundleSpec, RandomInput
from cspace.errors import BundleError
from cspace.plan import Seen, search_paths
from cspace.planning.paths import AlongPaths
from cspace.query import PlanQuery, SampleQuery
from cspace.world import CheckCancelled, Known, Sensor

CONFIDENCE, UNSEEN = "confidence", "unseen"
# Of the proposals that the validity head filters; the others are the generator's.
UNIFORM_SHARE = 0.25
# A head that reads arrays of space at hundreds of spheres a configuration is quickest while what it computes
# in between fits into a core's own cache: by 64 rows it takes 0.85 of the time that it takes by 512.
CACHED_ROWS = 64


@dataclass(frozen=True, slots=True)
class Encoding:
    """The encoder's view of one picture; ``mu`` is float32 (L,), ``sigma`` is float32 (L,), not negative."""

    mu: NDArray[np.float32]
    sigma: NDArray[np.float32]


@dataclass(frozen=True, eq=False)
class Picture:
    """A picture that a bundle has encoded, by :meth:`Bundle.prepare`; what it costs is paid once."""

    digest: str
    image: NDArray[np.uint8]  # uint8, decoded
    sensor: Sensor
    encoding: Encoding
    novelty: float | None = None  # 0 to 1, how unlike the training scenarios it is, where a bundle tells
    map: NDArray[np.float32] | None = None  # what the bundle's map graph makes of it, where it has one
    known: Known | None = None
    pictures: int = 1
    # How likely each voxel holds something, float16 (X, Y, Z), computed once; None where no graph tells
    occupancy: Callable[[], NDArray[np.float16]] | None = None

    @cached_property
    def pixels(self) -> NDArray[np.float32]:
        """float32 (1, C, ...), as the graphs take it: four times the image's bytes, made at the first use."""
        return self.sensor.to_network(self.image[None])

    @property
    def size_bytes(self) -> int:
        """Of what it holds, nearly, before the first use of its pixels."""
        known = 0 if self.known is None else self.known.size_bytes
        held = 0 if self.occupancy is None else self.image.nbytes
        return self.image.nbytes + held + (0 if self.map is None else self.map.nbytes) + known


@dataclass(frozen=True, slots=True, eq=False)
class OccupancyGrid:
    """What a model takes a scene to be, seen or not, on a grid of cells in the base frame."""

    low_m: tuple[float, float, float]
    cell_m: float
    # (X, Y, Z), the largest probability that one of a cell's eight voxels holds something
    occupied: NDArray[np.float32]


@dataclass(frozen=True, slots=True)
class ProposalCounts:
    """How many configurations were proposed, and how many of them are in the answer, by their kind."""

    generator: int = 0
    generator_kept: int = 0
    uniform: int = 0
    uniform_kept: int = 0


@dataclass(frozen=True, slots=True, eq=False)
class SampleSet:
    """Configurations for one picture, n' of the n that were asked for."""

    samples: NDArray[np.float32]  # (n', d) rad, circles in [-pi, pi), others within their limits
    # (n', k), the validity head's confidence, then the share of the robot that no picture shows where the
    # head gives that; no columns where the head was not asked
    scores: NDArray[np.float32]
    acceptance: float = 1.0  # share of what was drawn that reached the confidence asked for; 1 where none was
    ways: NDArray[np.int64] | None = None  # (n',), the path that each sample lies along, 0 for the best
    proposals: ProposalCounts | None = None  # by kind; None for samples along paths
    shortfall: int = 0
    encode_ms: float = 0.0  # time in the encoder; 0 for a picture that was prepared
    generate_ms: float = 0.0

    @property
    def confidence(self) -> NDArray[np.float32] | None:
        return self.scores[:, 0] if self.scores.shape[1] > 0 else None

    @property
    def unseen(self) -> NDArray[np.float32] | None:
        return self.scores[:, 1] if self.scores.shape[1] > 1 else None


class Head:
    """A bundle's validity head: its graph, asked about many configurations."""

    def __init__(self, graph: Graph) -> None:
        self._graph = graph
        self.reports_unseen, self.looks_at_map = UNSEEN in graph.outputs, MAP in graph.inputs
        self._outputs = (CONFIDENCE, UNSEEN) if self.reports_unseen else (CONFIDENCE,)

    def scores(
        self, picture: Picture, configurations: NDArray[np.float32], check_cancelled: CheckCancelled
    ) -> NDArray[np.float32]:
        """Confidence in (n, d) rad, and the unseen share where the head gives that, (n, 1) or (n, 2)."""
        fixed = {PICTURE: picture.pixels}
        if picture.map is not None and self.looks_at_map:
            fixed[MAP] = picture.map
        known = picture.known

        def predicted(part: NDArray[np.float32]) -> NDArray[np.float32]:
            shapes = dict.fromkeys(self._outputs, (len(part),))
            found = self._graph.run(fixed | {"configurations": part}, shapes)
            return np.stack([found[name] for name in self._outputs], axis=1)

        def score(rows: slice) -> NDArray[np.float32]:
            part = configurations[rows]
            if known is None:
                return predicted(part)
            # What is known is not predicted.
            certain = known.certain(part, check_cancelled)
            columns = np.zeros((len(part), len(self._outputs)), dtype=np.float32)
            columns[certain, 0] = 1.0
            if not certain.all():
                columns[~certain] = predicted(part[~certain])
            columns[~known.free(part, check_cancelled), 0] = 0.0
            return columns

        chunk_rows = CACHED_ROWS if self.reports_unseen else CHUNK_ROWS
        found = chunked(score, len(configurations), check_cancelled, chunk_rows)
        if np.any((found < 0.0) | (found > 1.0)):
            raise BundleError("the validity head gives no probabilities", expected="values from 0 to 1")
        return found

    def predict(
        self, picture: Picture, configurations: NDArray[np.float32], check_cancelled: CheckCancelled
    ) -> tuple[NDArray[np.float32], NDArray[np.float32] | None]:
        """The confidence, and the unseen share; None where the head does not give that."""
        found = self.scores(picture, configurations, check_cancelled)
        return found[:, 0], found[:, 1] if self.reports_unseen else None

    def seen(self, spec: BundleSpec, picture: Picture, check_cancelled: CheckCancelled) -> Seen:
        """A picture of the bundle's as the search for paths takes it."""
        return Seen(
            spec.world,
            picture.image,
            lambda rows: self.predict(picture, rows, check_cancelled),
            spec.calibration_for(picture.pictures),
            picture.known,
        )


def uniform_proposals(
    spec: BundleSpec, counts: Sequence[int], seed: int, turn: int
) -> tuple[NDArray[np.bool_], NDArray[np.float32]]:
    """Which of a turn's samples are uniform, (m,), and these, (u, d) rad. ``turn``: 0 for the first."""
    total, space = sum(counts), spec.world.space
    rng = np.random.Generator(np.random.PCG64(np.random.SeedSequence(seed, spawn_key=(turn, 1))))
    uniform = rng.random(total) < (0.0 if spec.kind == "path" else UNIFORM_SHARE)
    return uniform, space.to_float32(space.sample_uniform(rng, int(uniform.sum())))


@dataclass(frozen=True, slots=True)
class RandomNumbers:
    """The random part of one request."""

    latents: NDArray[np.float32]  # z = mu + (sigma + epsilon) * eta, float32 (m, L)
    random_inputs: dict[str, NDArray[np.float32]]  # name to float32 (m, *shape)
    kept: NDArray[np.bool_]  # (m, K), which samples of each latent belong to the answer


def random_numbers(
    spec: BundleSpec,
    mu: NDArray[np.float32],
    sigma: NDArray[np.float32],
    counts: Sequence[int],
    seed: int,
    epsilon_sigma: Sequence[float],
    turn: int = 0,
) -> RandomNumbers:
    """Everything random in one turn of a request, of the encoder's mean and deviation (L,)."""
    per_latent = spec.samples_per_latent
    epsilons: list[NDArray[np.float32]] = []
    kept: list[NDArray[np.bool_]] = []
    for epsilon, share in zip(epsilon_sigma, counts, strict=True):
        latents = -(-share // per_latent)
        epsilons.append(np.full(latents, epsilon, dtype=np.float32))
        kept.append((np.arange(latents * per_latent) < share).reshape(latents, per_latent))
    deviation = sigma + np.concatenate(epsilons)[:, None]
    source = np.random.SeedSequence(seed, spawn_key=(turn,) if turn else ())
    rng = np.random.Generator(np.random.PCG64(source))
    eta = rng.standard_normal(deviation.shape, dtype=np.float32)
    inputs = {item.name: _random_input(rng, item, len(eta)) for item in spec.random_inputs}
    return RandomNumbers(mu + deviation * eta, inputs, np.concatenate(kept))


def _random_input(rng: np.random.Generator, item: RandomInput, count: int) -> NDArray[np.float32]:
    shape = (count, *item.shape)
    if item.low is None or item.high is None:
        return rng.standard_normal(shape, dtype=np.float32)
    low, high = np.float32(item.low), np.float32(item.high)
    return low + (high - low) * rng.random(shape, dtype=np.float32)


# The first turn proposes so much more than is expected to be enough.
EXTRA = 1 / 16
# Of the samples asked for; a few more, so that a handful has a chance, too.
BUDGET, BUDGET_AT_LEAST = 4, 64
# A turn never expects less to pass, for a share of nothing would ask for everything.
LEAST_SHARE = 0.1

Propose = Callable[[Sequence[int], int], tuple[NDArray[np.float32], NDArray[np.float32]]]


def rejection_sample(
    propose_scored: Propose,
    shares: Sequence[int],
    threshold: float,
    expected: float,
    check_cancelled: CheckCancelled,
) -> SampleSet:
    """As many samples of each share as are wanted, or as many as the budget finds.

    Further turns propose what is missing by the share that passed so far. Surplus samples are left out from
    the end, so what is accepted does not depend on its score beyond having reached the threshold.

    ``propose_scored``: counts by share and the turn's number to samples (m, d), those of the first share
    first, and (m, k) whose first column is their confidence. ``expected``: share that is likely to pass.
    """
    left = max(BUDGET * sum(shares), BUDGET_AT_LEAST)
    found: list[tuple[NDArray[np.float32], NDArray[np.float32], NDArray[np.intp]]] = []
    missing = np.asarray(shares)
    sampled = passed = turn = 0
    wanted = [math.ceil(share * (1 + EXTRA) / expected) for share in shares]
    while True:
        if turn:
            check_cancelled()
        counts = np.diff(np.minimum(np.cumsum(wanted), left), prepend=0).tolist()
        samples, confidence = propose_scored(counts, turn)
        good = confidence[:, 0] >= np.float32(threshold)
        belongs = np.repeat(np.arange(len(counts)), counts)
        found.append((samples[good], confidence[good], belongs[good]))
        left, sampled, turn = left - len(samples), sampled + len(samples), turn + 1
        passed += int(good.sum())
        missing = np.maximum(missing - np.bincount(belongs[good], minlength=len(counts)), 0)
        if not missing.any() or left < 1:
            break
        passing = max(passed / sampled, LEAST_SHARE)
        wanted = [math.ceil(share * (1 + EXTRA) / passing) for share in missing.tolist()]
    samples, confidence, belongs = (np.concatenate(parts) for parts in zip(*found, strict=True))
    kept = np.concatenate([np.flatnonzero(belongs == share)[:count] for share, count in enumerate(shares)])
    return SampleSet(samples[kept], confidence[kept], passed / sampled)


# Share of a first turn's proposals that is likely to pass. Samples about a path are close to contact where it
# matters; of a generator's samples nearly all pass, and of uniform ones about every second.
PATHS_PASS, PROPOSALS_PASS = 0.75, 0.85


class GeneratorSampler:
    """Samples of a generator's graph within the robot's limits, rejected below a confidence to be reached."""

    def __init__(self, spec: BundleSpec, generator: Graph, head: Head | None) -> None:
        self._spec, self._generator, self._head = spec, generator, head

    def sample(
        self,
        picture: Picture,
        request: SampleQuery,
        *,
        report_confidence: bool,
        check_cancelled: CheckCancelled,
    ) -> SampleSet:
        """Samples for a picture; ``report_confidence`` scores those that are not filtered, too."""
        spec, head, space = self._spec, self._head, self._spec.world.space

        def generate(counts: Sequence[int], turn: int) -> NDArray[np.float32]:
            mu, sigma = picture.encoding.mu, picture.encoding.sigma
            draws = random_numbers(spec, mu, sigma, counts, request.seed, request.epsilon_sigma, turn)
            return self._generate(draws, request, picture, check_cancelled)

        share, rest = divmod(request.n, len(request.epsilon_sigma))
        wanted = [share + rest, *[share] * (len(request.epsilon_sigma) - 1)]
        if head is None or not request.min_confidence:
            known = picture.known

            def keeps(rows: NDArray[np.float32]) -> NDArray[np.bool_]:
                inside = space.keeps_pose(rows)
                return inside if known is None else inside & known.free(rows, check_cancelled)

            samples = space.to_float32(_inside(generate, wanted, keeps, check_cancelled))
            scored = head is not None and report_confidence
            return SampleSet(
                samples,
                _scores(head if scored else None, picture, samples, check_cancelled),
                proposals=ProposalCounts(generator=request.n, generator_kept=len(samples)),
            )

        counted = np.zeros(2, dtype=np.int64)

        def proposed(counts: Sequence[int], turn: int) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
            uniform, angles = uniform_proposals(spec, counts, request.seed, turn)
            rows = np.empty((len(uniform), spec.dim), dtype=np.float32)
            rows[uniform] = angles
            learned = [int((~part).sum()) for part in np.split(uniform, np.cumsum(counts)[:-1])]
            # Of a few all may be uniform.
            if any(learned):
                rows[~uniform] = generate(learned, turn)
            samples, inside = space.to_float32(rows), space.keeps_pose(rows)
            # What lies outside reaches no confidence, and is not scored. The last column tells uniform ones.
            scores = np.full((len(rows), 2 + head.reports_unseen), -1.0, dtype=np.float32)
            if inside.any():
                scores[inside, :-1] = head.scores(picture, samples[inside], check_cancelled)
            scores[:, -1] = uniform
            counted[:] += np.bincount(uniform, minlength=2)
            return samples, scores

        passes = PATHS_PASS if spec.kind == "path" else PROPOSALS_PASS
        found = rejection_sample(proposed, wanted, request.min_confidence, passes, check_cancelled)
        kept = int(found.scores[:, -1].sum())
        proposals = ProposalCounts(int(counted[0]), len(found.samples) - kept, int(counted[1]), kept)
        return replace(found, scores=found.scores[:, :-1], proposals=proposals)

    def _generate(
        self, draws: RandomNumbers, request: SampleQuery, picture: Picture, check_cancelled: CheckCancelled
    ) -> NDArray[np.float32]:
        spec = self._spec
        seen = {PICTURE: picture.pixels} if spec.looks_at_picture else {}
        seen |= {MAP: picture.map} if spec.looks_at_map and picture.map is not None else {}
        fixed = {
            name: np.asarray(point, dtype=np.float32)
            for name, point in (("start", request.start), ("goal", request.goal))
            if point is not None
        }

        def run(rows: slice) -> NDArray[np.float32]:
            latents = draws.latents[rows]
            feeds = {"latent": latents, **{name: array[rows] for name, array in draws.random_inputs.items()}}
            feeds |= {name: np.tile(point, (len(latents), 1)) for name, point in fixed.items()} | seen
            shape = (len(latents), spec.samples_per_latent, spec.dim)
            return self._generator.run(feeds, {"samples": shape})["samples"]

        chunk_rows = PATH_CHUNK_ROWS if spec.kind == "path" else CHUNK_ROWS
        return chunked(run, len(draws.latents), check_cancelled, chunk_rows)[draws.kept]


def _inside(
    draw_rows: Callable[[Sequence[int], int], NDArray[np.float32]],
    wanted: Sequence[int],
    is_kept: Callable[[NDArray[np.float32]], NDArray[np.bool_]],
    check_cancelled: CheckCancelled,
) -> NDArray[np.float32]:
    """Rows (n, d) of a first turn, where further ones replace what is not kept, as far as the budget goes."""
    rows = draw_rows(wanted, 0)
    inside = is_kept(rows)
    if inside.all():
        return rows

    def again(counts: Sequence[int], turn: int) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        more = draw_rows(counts, turn + 1)
        return more, is_kept(more).astype(np.float32)[:, None]

    belongs = np.repeat(np.arange(len(wanted)), wanted)
    missing = np.bincount(belongs[~inside], minlength=len(wanted)).tolist()
    found = rejection_sample(
        again, missing, 1.0, max(float(inside.mean()), LEAST_SHARE), check_cancelled
    ).samples
    rows[np.flatnonzero(~inside)[: len(found)]] = found
    return rows


def _scores(
    head: Head | None, picture: Picture, samples: NDArray[np.float32], check_cancelled: CheckCancelled
) -> NDArray[np.float32]:
    """What a head gives for samples (n, d) rad, (n, k); no columns without one."""
    if head is None:
        return np.empty((len(samples), 0), dtype=np.float32)
    return head.scores(picture, samples, check_cancelled)


# On the best path most configurations are likely enough to be free, about it fewer.
_PASS = 0.75


class PathSampler:
    """Samples along paths from start to goal that are searched for through what a picture shows, in order.

    The latent and ``epsilon_sigma`` are not used. A picture without a path gives no samples.
    """

    def __init__(self, spec: BundleSpec, head: Head) -> None:
        self._spec, self._head = spec, head

    def sample(
        self,
        picture: Picture,
        request: SampleQuery,
        *,
        report_confidence: bool,
        check_cancelled: CheckCancelled,
    ) -> SampleSet:
        """As :meth:`GeneratorSampler.sample`; no time ends the search, its effort does."""
        spec, head, space = self._spec, self._head, self._spec.world.space
        ends = np.asarray([request.start, request.goal], dtype=np.float64)
        query = PlanQuery(tuple(ends[0]), tuple(ends[1]), request.seed, time_limit_s=math.inf)
        searched = search_paths(head.seen(spec, picture, check_cancelled), ends, query, check_cancelled)
        if not searched.paths:
            none = np.empty((0, 1 + head.reports_unseen), dtype=np.float32)
            rows = space.to_float32(np.empty((0, space.dim)))
            return SampleSet(rows, none, ways=np.empty(0, dtype=np.int64))
        along = AlongPaths(
            [one.path for one in searched.paths], space, np.random.default_rng([request.seed, 1])
        )

        def proposed(counts: Sequence[int], turn: int) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
            del turn
            rows, numbers = along.take(sum(counts))
            samples = space.to_float32(rows)
            scored = bool(request.min_confidence) or report_confidence
            scores = _scores(head if scored else None, picture, samples, check_cancelled)
            return samples, np.column_stack([scores, numbers.astype(np.float32)])

        if request.min_confidence:
            found = rejection_sample(proposed, [request.n], request.min_confidence, _PASS, check_cancelled)
        else:
            found = SampleSet(*proposed([request.n], 0))
        # The last column is the path that a sample lies along.
        numbers = found.scores[:, -1].astype(np.int64)
        return SampleSet(found.samples, found.scores[:, :-1], found.acceptance, numbers)
