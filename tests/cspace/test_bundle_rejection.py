from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from cspace.bundle import Bundle
from cspace.bundle.sampling import BUDGET, rejection_sample
from tests.bundles import picture

Scored = tuple[NDArray[np.float32], NDArray[np.float32]]


class Source:
    """Numbered samples; each share passes with its own chance."""

    def __init__(self, *chances: float) -> None:
        self.chances, self.turns, self.drawn = chances, list[list[int]](), 0
        self.rng = np.random.default_rng(0)

    def __call__(self, counts: Sequence[int], turn: int) -> Scored:
        assert turn == len(self.turns)
        self.turns.append(list(counts))
        self.drawn += sum(counts)
        shares = np.repeat(np.arange(len(counts)), counts)
        samples = np.stack([shares, np.full(len(shares), turn)], axis=1).astype(np.float32)
        passes = self.rng.random(len(shares)) < np.asarray(self.chances)[shares]
        return samples, np.where(passes, 0.9, 0.1).astype(np.float32)[:, None]


def test_every_share_is_filled_and_stays_in_its_place() -> None:
    source = Source(0.9, 0.4)
    kept = rejection_sample(source, [100, 50], 0.5)
    assert kept.samples[:, 0].tolist() == [0.0] * 100 + [1.0] * 50
    # Within a share the turns follow each other.
    assert (np.diff(kept.samples[:100, 1]) >= 0).all()
    assert (np.diff(kept.samples[100:, 1]) >= 0).all()
    # A share that is full is drawn no more.
    assert source.turns[-1][0] == 0 < source.turns[-1][1]
    assert (kept.scores >= 0.5).all()


def test_the_budget_ends_a_search_in_vain() -> None:
    source = Source(0.0, 0.0)
    kept = rejection_sample(source, [200, 100], 0.5)
    assert (len(kept.samples), kept.acceptance) == (0, 0.0)
    assert source.drawn == BUDGET * 300


def test_samples_are_the_same_where_nobody_is_told_their_confidence(tiny_bundle: Path) -> None:
    bundle = Bundle.load(tiny_bundle)
    with_confidence = bundle.sample(picture(), 40, 2, min_confidence=0.0)
    without_confidence = bundle.sample(picture(), 40, 2, min_confidence=0.0, report_confidence=False)
    assert with_confidence.confidence is not None
    assert without_confidence.confidence is None
    np.testing.assert_array_equal(without_confidence.samples, with_confidence.samples)
    filtered = [
        bundle.sample(picture(), 40, 2, min_confidence=0.4, report_confidence=tell) for tell in (True, False)
    ]
    np.testing.assert_array_equal(filtered[0].samples, filtered[1].samples)
