"""Oversample, score, keep: how a request with a confidence to reach comes by its samples.

The first turn draws a sixteenth more than is expected to be enough, further turns what is missing by the
share that passed so far, until nothing is missing or as much has been drawn as the budget allows. What is
too many is left out from the end, so what is kept does not depend on its score beyond having reached the
threshold.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

EXTRA = 1 / 16
# Of the samples asked for; a few more, so that a handful has a chance, too.
BUDGET, BUDGET_AT_LEAST = 4, 64
# A turn never expects less to pass, for a share of nothing would ask for everything.
LEAST_SHARE = 0.1

DrawScored = Callable[[Sequence[int], int], tuple[NDArray[np.float32], NDArray[np.float32]]]


@dataclass(frozen=True, slots=True, eq=False)
class Kept:
    """What reached the threshold.

    Args:
        samples: float32 (n', d) rad, those of the first share first.
        confidence: float32 (n',), or (n', k) with what else was told of each behind it.
        acceptance: share of all drawn samples that reached the threshold.
    """

    samples: NDArray[np.float32]
    confidence: NDArray[np.float32]
    acceptance: float


def gather(
    draw: DrawScored,
    shares: Sequence[int],
    threshold: float,
    expected: float = 1.0,
    between: Callable[[], None] | None = None,
) -> Kept:
    """As many samples of each share as are wanted, or as many as the budget finds.

    Args:
        draw: counts by share and the turn's number to samples (m, d), those of the first share first, and
            their confidence (m,), or (m, k) with what else is told of each behind it.
        shares: how many are wanted of each.
        threshold: the least confidence, 0 to 1.
        expected: share that is likely to pass, above 0 to 1; a further turn costs more than a few too many.
        between: called between two turns; what it raises passes through.
    """
    left = max(BUDGET * sum(shares), BUDGET_AT_LEAST)
    found: list[tuple[NDArray[np.float32], NDArray[np.float32], NDArray[np.intp]]] = []
    missing = np.asarray(shares)
    drawn = passed = turn = 0
    wanted = [math.ceil(share * (1 + EXTRA) / expected) for share in shares]
    while True:
        if turn and between is not None:
            between()
        counts = _within(wanted, left)
        samples, confidence = draw(counts, turn)
        good = (confidence if confidence.ndim == 1 else confidence[:, 0]) >= np.float32(threshold)
        if turn == 0 and len(shares) == 1:
            # Nearly every request ends here, and the arrays below would cost it a tenth of a millisecond.
            kept = np.flatnonzero(good)
            if len(kept) >= shares[0]:
                first = kept[: shares[0]]
                return Kept(samples[first], confidence[first], len(kept) / len(samples))
        belongs = np.repeat(np.arange(len(counts)), counts)
        found.append((samples[good], confidence[good], belongs[good]))
        left, drawn, passed, turn = (
            left - len(samples),
            drawn + len(samples),
            passed + int(good.sum()),
            turn + 1,
        )
        missing = np.maximum(missing - np.bincount(belongs[good], minlength=len(counts)), 0)
        if not missing.any() or left < 1:
            break
        passing = max(passed / drawn, LEAST_SHARE)
        wanted = [math.ceil(share * (1 + EXTRA) / passing) for share in missing.tolist()]
    samples, confidence, belongs = (np.concatenate(parts) for parts in zip(*found, strict=True))
    kept = np.concatenate([np.flatnonzero(belongs == share)[:count] for share, count in enumerate(shares)])
    return Kept(samples[kept], confidence[kept], passed / drawn)


def _within(wanted: Sequence[int], left: int) -> list[int]:
    """The counts, cut where the budget ends."""
    cut = []
    for count in wanted:
        cut.append(min(count, max(left, 0)))
        left -= count
    return cut
