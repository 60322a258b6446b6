"""Samples of a generator's graph; with a confidence to reach more are drawn and scored until enough reach it.

What is random and in which order is told in :mod:`cspace.bundle.draws`, how a request that filters comes by
its samples in :mod:`cspace.bundle.keeping`.
"""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from cspace.bundle.draws import Draws, draw, propose, shares
from cspace.bundle.keeping import gather
from cspace.bundle.request import FittedQuery
from cspace.bundle.running.chunks import CHUNK_ROWS, PATH_CHUNK_ROWS, Between, chunked
from cspace.bundle.running.graphs import Graph
from cspace.bundle.running.head import Head
from cspace.bundle.samples import Drawn, Picture
from cspace.bundle.spec import MAP, PICTURE, BundleSpec

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
        spec, head = self._spec, self._head

        def drawn(counts: Sequence[int], turn: int) -> NDArray[np.float32]:
            mu, sigma = picture.encoding.mu, picture.encoding.sigma
            draws = draw(spec, mu, sigma, counts, request.seed, request.epsilon_sigma, turn)
            return spec.world.space.to_float32(self._generate(draws, request, picture, between))

        wanted = shares(request.n, len(request.epsilon_sigma))
        if head is None or not (request.min_confidence or tell_confidence):
            return Drawn(drawn(wanted, 0))
        if not request.min_confidence:
            samples = drawn(wanted, 0)
            return Drawn(samples, head.told(picture, samples, between))

        def proposed(counts: Sequence[int], turn: int) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
            proposals = propose(spec, counts, request.seed, turn)
            learned = drawn(proposals.learned, turn) if any(proposals.learned) else None
            samples = proposals.mixed_with(learned)
            return samples, head.told(picture, samples, between)

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


def expected_share(spec: BundleSpec) -> float:
    """Share of a first turn's proposals that is likely to pass."""
    if spec.kind == "path":
        return PATHS_PASS
    if spec.passing_share is not None:
        return spec.passing_share
    # Of a free-space generator's samples nearly all pass, of uniform ones about every second.
    return 1.0 - spec.uniform_share / 2.0
