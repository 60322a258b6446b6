"""Splits of seeded draws: what is drawn for one of them never appears in another, whatever the seeds."""

import hashlib
from enum import StrEnum

import numpy as np


class Split(StrEnum):
    """What a scenario may be used for."""

    TRAIN = "train"
    VALIDATION = "validation"
    TEST = "test"
    DEMO = "demo"


_SPLIT_KEYS = {Split.TRAIN: 1, Split.VALIDATION: 2, Split.TEST: 3, Split.DEMO: 4}


def scenario_rng(split: Split, seed: int, index: int) -> np.random.Generator:
    """The random generator of one scenario; independent over splits, seeds and indices."""
    return np.random.default_rng(
        np.random.SeedSequence(entropy=seed, spawn_key=(_SPLIT_KEYS[Split(split)], index))
    )


def derived_seed(seed: int, *use: str) -> int:
    """A seed of 63 bits for one use of a seed; independent over seeds and uses.

    Args:
        seed: that a user gave.
        use: names of what it is for.
    """
    key = np.frombuffer(hashlib.sha256("/".join(use).encode()).digest()[:16], dtype=np.uint32)
    sequence = np.random.SeedSequence(entropy=seed, spawn_key=tuple(int(word) for word in key))
    return int(sequence.generate_state(1, np.uint64)[0] >> np.uint64(1))
