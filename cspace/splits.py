"""Splits of seeded draws: what is drawn for one of them never appears in another, whatever the seeds."""

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
