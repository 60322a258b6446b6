"""Whether plans collide more often than their confidence says: a sequential test of reported outcomes."""

import logging
import math
from collections.abc import MutableMapping, Sequence
from threading import Lock

from cachetools import LRUCache

ALARM = 6.0
"""Evidence, a power of ten, from which there is an alarm: by chance after a million outcomes on average."""
# Of the odds of a collision, which the test bets on; each as much.
_TIMES = (2.0, 4.0, 8.0)
# Surer than that nobody is believed to be: one collision would settle it.
_LEAST_RISK, _MOST_RISK = 0.01, 0.999
_MOST_SITES, _MOST_SUM = 64, 1e300
_LOG = logging.getLogger(__name__)


def e_value(confidence: float, collided: bool) -> float:
    """Evidence of one plan that collisions are more frequent than stated; on average at most 1 if not.

    The likelihood of what happened if the odds of a collision are 2, 4 or 8 times the stated ones, over that
    if they are as stated, on average.
    """
    risk = min(max(1.0 - confidence, _LEAST_RISK), _MOST_RISK)
    odds = risk / (1.0 - risk)
    ratios = []
    for times in _TIMES:
        other = times * odds / (1.0 + times * odds)
        ratios.append(other / risk if collided else (1.0 - other) / (1.0 - risk))
    return sum(ratios) / len(ratios)


class CollisionDrift:
    """Shiryaev-Roberts sums of e-values, one per site; safe to share between threads.

    R_n = (R_{n-1} + 1) e_n. As long as plans collide as rarely as stated, or more rarely, at least c outcomes
    go by on average until R reaches c (Shin, Ramdas and Rinaldo, E-detectors: a nonparametric framework for
    sequential change detection). The 64 sites that reported last are remembered.
    """

    def __init__(self) -> None:
        self._sums: MutableMapping[str, float] = LRUCache(_MOST_SITES)
        self._lock = Lock()

    def add(self, site: str, plans: Sequence[tuple[float, bool]]) -> float:
        """Count plans by confidence and whether they collided; returns the largest log10 R of all sites."""
        with self._lock:
            before = after = self._sums.get(site, 0.0)
            for confidence, collided in plans:
                after = min((after + 1.0) * e_value(confidence, collided), _MOST_SUM)
            self._sums[site] = after
            largest = max(self._sums.values())
        if before < 10.0**ALARM <= after:
            _LOG.warning("plans at the site %r collide more often than their confidence says", site)
        return math.log10(max(1.0, largest))
