"""Samples along ways from start to goal that are searched for through what a picture shows.

Nothing is trained on paths: of several ways the validity head says which it doubts least, and configurations
are drawn along them in order (:mod:`cspace.planning.paths`), with a confidence to reach those alone that
reach it. The latent is not looked at, and neither is ``epsilon_sigma``. A picture through which no way is
found gives no samples.
"""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from cspace.bundle.draws import shares
from cspace.bundle.keeping import gather
from cspace.bundle.request import FittedQuery, fitted_ends
from cspace.bundle.running.chunks import Between
from cspace.bundle.running.head import Head
from cspace.bundle.samples import Drawn, Picture
from cspace.bundle.spec import BundleSpec
from cspace.plan import search_paths
from cspace.planning.paths import AlongPaths
from cspace.query import DEFAULT_WAYS

# On a way that the head doubts least most are sure enough, about it fewer.
_PASS = 0.75


class WaySampler:
    """See :class:`cspace.bundle.drawing.samplers.Sampler`.

    Args:
        spec: of the bundle.
        head: that chooses among ways and scores.
    """

    def __init__(self, spec: BundleSpec, head: Head) -> None:
        self._spec, self._head = spec, head

    def draw(
        self, picture: Picture, request: FittedQuery, *, tell_confidence: bool, between: Between | None
    ) -> Drawn:
        """See the class; no time ends the search, its effort does."""
        spec, head, space = self._spec, self._head, self._spec.world.space
        ends = fitted_ends(spec, request.start or (), request.goal or ())
        found = search_paths(
            head.seen(spec, picture, between), ends, DEFAULT_WAYS, request.seed, between=between
        )
        if not found.ways:
            nothing = np.empty(0, dtype=np.float32)
            told = np.empty((0, 2), dtype=np.float32) if head.tells_unseen else nothing
            return Drawn(space.to_float32(np.empty((0, space.dim))), told, ways=nothing.astype(np.int64))
        along = AlongPaths([one.way for one in found.ways], space, np.random.default_rng([request.seed, 1]))

        def drawn(counts: Sequence[int], turn: int) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
            del turn
            rows, numbers = along.take(sum(counts))
            samples = space.to_float32(rows)
            columns = [numbers.astype(np.float32)[:, None]]
            if request.min_confidence or tell_confidence:
                told = head.told(picture, samples, between)
                columns.insert(0, told.reshape(len(told), -1))
            return samples, np.concatenate(columns, axis=1)

        wanted = shares(request.n, 1)
        if not request.min_confidence:
            samples, told, acceptance = *drawn(wanted, 0), 1.0
        else:
            kept = gather(drawn, wanted, request.min_confidence, _PASS, between)
            samples, told, acceptance = kept.samples, kept.confidence, kept.acceptance
        scores = told[:, :-1]
        if not scores.shape[1]:
            return Drawn(samples, None, acceptance, told[:, -1].astype(np.int64))
        return Drawn(
            samples,
            scores if head.tells_unseen else scores[:, 0],
            acceptance,
            told[:, -1].astype(np.int64),
        )
