"""Several paths through what a picture shows: RRT-Connect and shortcuts, each from draws of its own."""

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from cspace.planning.paths import shortcut
from cspace.planning.rrt_connect import Growth, grow_connect
from cspace.simulator import Checker
from cspace.world import CheckCancelled


class OutOfTimeError(Exception):
    """The time for the search is over."""


@dataclass(frozen=True, slots=True, eq=False)
class FoundPaths:
    """What a search for paths came to."""

    paths: list[NDArray[np.float64]]  # (k, d) rad each
    late: bool  # whether the time was over before there were as many as were wanted
    checker: Checker | None  # by which they are free; None without paths


@dataclass(frozen=True, slots=True)
class SearchLimits:
    """Effort for each path."""

    states: int = 4096  # uniform ones that trees grow towards, most
    first: int = 256  # of them in the first round over all checkers; each next round has four times as many
    range_rad: float = 2.0  # longest step of a tree, the sum over the joints
    search_rad: float = 0.05  # between states that trees look at, the largest over the joints
    shortcuts: int = 64
    shortcut_rad: float = 0.03  # the same as ``search_rad`` for shortcuts

    def rounds(self) -> list[int]:
        """States of each round, to the most."""
        found = [min(self.first, self.states)]
        while found[-1] < self.states:
            found.append(min(4 * found[-1], self.states))
        return found


def find_paths(
    checkers: Sequence[Checker],
    start: NDArray[np.float64],
    goal: NDArray[np.float64],
    count: int,
    seed: int,
    until_s: float,
    *,
    limits: SearchLimits = SearchLimits(),
    check_cancelled: CheckCancelled | None = None,
) -> FoundPaths:
    """Up to so many paths.

    Of several goals each gets its first path before another gets a second; one without a path is left out.
    The most careful checker in which a path is found with as few states as any gives all of them: all are
    tried in turn, with few states at first, for a careful one without a path would take all the time.

    ``goal``: (d,) rad, or (g, d) of which any will do. ``until_s``: by ``time.thread_time``: what the thread
    has computed, not what it has waited for others.
    """
    check_cancelled = with_deadline(until_s, check_cancelled)
    found: list[NDArray[np.float64]] = []
    goals = np.atleast_2d(goal)
    possible: list[tuple[int, NDArray[np.float64]]] = []
    for level, one in enumerate(checkers):
        free = one.valid_batch(np.concatenate([[start], goals]))
        if free[0] and free[1:].any():
            possible.append((level, goals[free[1:]]))
    checker = None
    try:
        for states in limits.rounds():
            for level, reachable in possible:
                left, number = list(reachable), 0
                while left and len(found) < count:
                    at, rng = len(found) % len(left), np.random.default_rng([seed, level, number])
                    # A goal that was reached once is worth all states.
                    most = states if number < len(reachable) else limits.states
                    path = _path(checkers[level], start, left[at], rng, limits, most, check_cancelled)
                    number += 1
                    if path is None:
                        del left[at]
                        continue
                    found.append(path)
                    checker = checkers[level]
                    check_cancelled()
                if found:
                    return FoundPaths(found, late=False, checker=checker)
    except OutOfTimeError:
        return FoundPaths(found, late=True, checker=checker)
    return FoundPaths(found, late=False, checker=checker)


def with_deadline(until_s: float, check_cancelled: CheckCancelled | None) -> Callable[[], None]:
    """``check_cancelled`` that also raises :class:`OutOfTimeError` from a ``time.thread_time`` on."""

    def check() -> None:
        if check_cancelled is not None:
            check_cancelled()
        if time.thread_time() > until_s:
            raise OutOfTimeError

    return check


def _path(
    checker: Checker,
    start: NDArray[np.float64],
    goal: NDArray[np.float64],
    rng: np.random.Generator,
    limits: SearchLimits,
    most: int,
    check_cancelled: CheckCancelled,
) -> NDArray[np.float64] | None:
    # All are drawn, so that what follows does not depend on how many are used.
    states = checker.space.sample_uniform(rng, limits.states)[:most]
    growth = Growth(limits.range_rad, limits.search_rad, check_cancelled=check_cancelled)
    raw = grow_connect(checker, start, goal, states, growth).path
    return None if raw is None else shortcut(checker, raw, rng, limits.shortcuts, limits.shortcut_rad)
