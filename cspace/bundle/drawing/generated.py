"""Samples of a generator's graph; with a confidence to reach more are drawn and scored until enough reach it.

The graph may have been trained for wider limits than the description tells: what it puts outside the robot's
limits is rejected, and drawn again. What is random and in which order is told in :mod:`cspace.bundle.draws`,
how a request that filters comes by its samples in :mod:`cspace.bundle.keeping`.
"""

from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray

from cspace.bundle.draws import Draws, draw, propose, shares
from cspace.bundle.keeping import LEAST_SHARE, gather
from cspace.bundle.request import FittedQuery
from cspace.bundle.running.chunks import CHUNK_ROWS, PATH_CHUNK_ROWS, Between, chunked
from cspace.bundle.running.graphs import Graph
from cspace.bundle.running.head import Head
from cspace.bundle.samples import Drawn, Picture
from cspace.bundle.spec import MAP, PICTURE, BundleSpec
from cspace.space import JointSpace

# Samples about a path are close to contact where it matters, and a further turn costs a further search.
PATHS_PASS = 0.75


class GeneratorSampler:
    """See :class:`cspace.bundle.drawing.samplers.Sampler`.

    Args:
        spec: of the bundle.
        generator: its graph.
        head: that scores; None for a bundle without.
    """

    def __init__(self, spec: BundleSpec, generator: Graph, head: Head | None) -> None:
        self._spec, self._generator, self._head = spec, generator, head

    def draw(
        self, picture: Picture, request: FittedQuery, *, tell_confidence: bool, between: Between | None
    ) -> Drawn:
        """See the class."""
        spec, head, space = self._spec, self._head, self._spec.world.space

        def drawn(counts: Sequence[int], turn: int) -> NDArray[np.float32]:
            mu, sigma = picture.encoding.mu, picture.encoding.sigma
            draws = draw(spec, mu, sigma, counts, request.seed, request.epsilon_sigma, turn)
            return self._generate(draws, request, picture, between)

        wanted = shares(request.n, len(request.epsilon_sigma))
        if head is None or not request.min_confidence:
            samples = space.to_float32(_inside(drawn, wanted, space, between))
            told = head.told(picture, samples, between) if head is not None and tell_confidence else None
            return Drawn(samples, told)

        def proposed(counts: Sequence[int], turn: int) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
            proposals = propose(spec, counts, request.seed, turn)
            learned = drawn(proposals.learned, turn) if any(proposals.learned) else None
            rows = proposals.mixed_with(learned)
            samples, inside = space.to_float32(rows), space.keeps_pose(rows)
            # What lies outside reaches no confidence, and is not scored.
            told = np.full((len(rows), 1 + head.tells_unseen), -1.0, dtype=np.float32)
            if inside.any():
                found = head.told(picture, samples[inside], between)
                told[inside] = found.reshape(len(found), -1)
            return samples, told if head.tells_unseen else told[:, 0]

        kept = gather(proposed, wanted, request.min_confidence, expected_share(spec), between)
        return Drawn(kept.samples, kept.confidence, kept.acceptance)

    def _generate(
        self, draws: Draws, request: FittedQuery, picture: Picture, between: Between | None
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
        return chunked(run, len(draws.latents), between, chunk_rows)[draws.kept]


def _inside(
    draw_rows: Callable[[Sequence[int], int], NDArray[np.float32]],
    wanted: Sequence[int],
    space: JointSpace,
    between: Between | None,
) -> NDArray[np.float32]:
    """Rows (n, d) of a first turn, where further ones replace what that puts outside the limits.

    What the budget of :func:`gather` does not replace stays, for the limits to bound.
    """
    rows = draw_rows(wanted, 0)
    inside = space.keeps_pose(rows)
    if inside.all():
        return rows

    def again(counts: Sequence[int], turn: int) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        more = draw_rows(counts, turn + 1)
        return more, space.keeps_pose(more).astype(np.float32)

    belongs = np.repeat(np.arange(len(wanted)), wanted)
    missing = np.bincount(belongs[~inside], minlength=len(wanted)).tolist()
    found = gather(again, missing, 1.0, max(float(inside.mean()), LEAST_SHARE), between).samples
    rows[np.flatnonzero(~inside)[: len(found)]] = found
    return rows


def expected_share(spec: BundleSpec) -> float:
    """Share of a first turn's proposals that is likely to pass."""
    if spec.kind == "path":
        return PATHS_PASS
    if spec.passing_share is not None:
        return spec.passing_share
    # Of a free-space generator's samples nearly all pass, of uniform ones about every second.
    return 1.0 - spec.uniform_share / 2.0
