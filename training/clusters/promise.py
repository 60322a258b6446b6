"""What a bundle promises of what passes its threshold: a conformal bound over validation scenes.

Each scene has one risk, the share of colliding configurations among those that pass; scenes are exchangeable
draws, and a bound on the next one's expected risk follows from those seen, whatever the head is like
(Angelopoulos et al., Conformal Risk Control, 2022, theorem 1, for one threshold). A third of the scenes
chooses the threshold, another one makes the promise, and the last one measures it.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from training.clusters.threshold import CANDIDATES, Scored

FINE = (*CANDIDATES, 0.96, 0.97, 0.98, 0.99)
# Of scenes, whose risk the second statement bounds.
MOST = 0.9


@dataclass(frozen=True, slots=True)
class Promise:
    """What is promised of one kind of configurations, and what came of it in scenes that had no part in it.

    Args:
        at_most: bound on the expected share of what passes that collides.
        in_most: bound on that share in nine scenes of ten.
        scenes: that it was made on.
        measured: mean share that collided in the other scenes.
        violations: share of the other scenes in which more than ``in_most`` did.
        others: how many these were.
    """

    at_most: float
    in_most: float
    scenes: int
    measured: float
    violations: float
    others: int

    def metrics(self, kind: str) -> dict[str, float]:
        """As a bundle's provenance holds it."""
        told = {
            "at_most": self.at_most,
            "at_most_in_nine_of_ten_scenes": self.in_most,
            "scenes": float(self.scenes),
            "measured": self.measured,
            "measured_violations": self.violations,
            "measured_scenes": float(self.others),
        }
        return {f"promise/{kind}_collide/{name}": value for name, value in told.items()}


def choose_promised(scenes: Sequence[Scored], at_most: float) -> float:
    """The lowest threshold that would promise as little as is wanted, by the scenes that choose.

    Args:
        scenes: all of them, samples of the bundle.
        at_most: the bound that is wanted.

    Returns:
        The highest threshold where none is low enough.
    """
    choosing = scenes[::3]
    return next((one for one in FINE if _bound(_risks(choosing, one)) <= at_most), FINE[-1])


def make_promise(scenes: Sequence[Scored], threshold: float) -> Promise:
    """What holds at a threshold that the other scenes decided nothing of."""
    made, others = np.sort(_risks(scenes[1::3], threshold)), _risks(scenes[2::3], threshold)
    place = math.ceil((len(made) + 1) * MOST)
    in_most = float(made[place - 1]) if place <= len(made) else 1.0
    return Promise(
        at_most=_bound(made),
        in_most=in_most,
        scenes=len(made),
        measured=float(others.mean()),
        violations=float(np.mean(others > in_most)),
        others=len(others),
    )


def _bound(risks: NDArray[np.float64]) -> float:
    return (float(risks.sum()) + 1.0) / (len(risks) + 1)


def _risks(scenes: Sequence[Scored], threshold: float) -> NDArray[np.float64]:
    """(scenes,): shares of what passes that collide; 0 where nothing passes."""
    shares = [one.passing(threshold) for one in scenes]
    return np.array([1.0 - free / passing if passing else 0.0 for passing, free in shares])
