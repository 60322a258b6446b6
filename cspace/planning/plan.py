"""A way from start to goal in what a model believes of a picture, or the reason why there is none.

Ways are searched for through what the picture shows, where all that it does not show is free; the model is
asked about them, the surest are changed until it doubts them less, and the one that it doubts least is taken.
"""

import math
import time
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from cspace.connecting import Between
from cspace.planning.compiled import load_kernels
from cspace.planning.less_doubt import Doubter, Effort
from cspace.planning.query import Plan, PlanQuery
from cspace.planning.scoring import Believe, ScoredWay, score
from cspace.planning.ways import find_ways, paused
from cspace.world import Image, World
from cspace.worlds import best_view, seen_checkers

# Between states that the model is asked about.
STEP_RAD = 0.15


@dataclass(frozen=True, slots=True, eq=False)
class Seen:
    """A scene as a model knows it.

    Args:
        world: the robot and how it is seen.
        picture: of the scene.
        believe: what the model says of configurations in it.
        plan_doubt: (a, b), see :mod:`cspace.planning.scoring`.
    """

    world: World
    picture: Image
    believe: Believe
    plan_doubt: tuple[float, float] = (0.0, 1.0)


@dataclass(frozen=True, slots=True, eq=False)
class Searched:
    """Ways through what a picture shows.

    Args:
        ways: the least doubtful first.
        late: whether the time was over before there were as many as were wanted.
        search_ms: looking for them.
        score_ms: asking the model about them, and changing them until it doubts them less.
    """

    ways: list[ScoredWay]
    late: bool
    search_ms: float
    score_ms: float


def plan(seen: Seen, ends: NDArray[np.float64], query: PlanQuery, between: Between | None = None) -> Plan:
    """Plan.

    Args:
        seen: the scene.
        ends: (2, d) rad, the query's start and goal as the model takes them.
        query: the problem; without ``min_confidence`` every way is sure enough.
        between: called now and then; may raise to stop, which passes through.

    Raises:
        InputError: one of the query's views is no camera, or one that the picture is from has no pose.
        ImportError: the compiler of the checks is not installed.
    """
    least = query.min_confidence or 0.0
    ways = search_ways(seen, ends, query.ways, query.seed, query.time_limit_s, between)
    if ways.ways:
        best = ways.ways[0]
        found = _answer(best, len(ways.ways), least)
        if query.alternatives:
            sure = tuple(one.believed() for one in ways.ways if one.whole >= least)
            found = replace(found, alternatives=sure)
        if query.next_view:
            pause = between or (lambda: None)
            view = best_view(
                seen.world, seen.picture, best.states, best.doubts, query.views, pause, query.seen_by
            )
            found = replace(found, next_view=view)
    else:
        found = Plan("timeout" if ways.late else "refused", np.empty((0, seen.world.dim)))
    return replace(found, search_ms=ways.search_ms, score_ms=ways.score_ms)


def search_ways(
    seen: Seen,
    ends: NDArray[np.float64],
    count: int,
    seed: int,
    time_limit_s: float = math.inf,
    between: Between | None = None,
) -> Searched:
    """Up to so many ways from ``ends[0]`` to ``ends[1]``, scored.

    Args:
        seen: the scene.
        ends: (2, d) rad.
        count: of ways.
        seed: of all draws.
        time_limit_s: of computing, for the search; without one the ways depend on nothing but the rest.
        between: called now and then; may raise to stop, which passes through.

    Raises:
        ImportError: the compiler of the checks is not installed.
    """
    checkers = seen_checkers(seen.world, seen.picture, ends)
    # Before the time counts.
    load_kernels(checkers[0], ends[0], STEP_RAD)
    began = time.monotonic()
    until_s = time.thread_time() + time_limit_s
    found = find_ways(checkers, ends[0], ends[1], count, seed, until_s, between=between)
    searched = time.monotonic()
    scored = score(found.ways, seen.world.space, STEP_RAD, seen.believe, seen.plan_doubt)
    ranked = sorted(scored, key=_by_doubt)
    if found.checker is not None:
        pause = paused(until_s, between)
        doubter = Doubter(found.checker, seen.believe, seen.plan_doubt, Effort(step_rad=STEP_RAD), pause)
        ranked = _less_doubtful(ranked, doubter, seed)
    return Searched(ranked, found.late, 1e3 * (searched - began), 1e3 * (time.monotonic() - searched))


def _less_doubtful(ranked: list[ScoredWay], doubter: Doubter, seed: int) -> list[ScoredWay]:
    """The ways, the first of them changed."""
    changed = ranked[: doubter.effort.ways]
    found = [
        doubter.less_doubtful(way, np.random.default_rng([seed, number, 1]))
        for number, way in enumerate(changed)
    ]
    return sorted([*found, *ranked[len(changed) :]], key=_by_doubt)


def _by_doubt(way: ScoredWay) -> float:
    return way.doubt


def _answer(best: ScoredWay, found: int, min_confidence: float) -> Plan:
    least, sure = best.least(), best.whole
    if sure < min_confidence:
        nothing = np.empty((0, best.way.shape[1]))
        return Plan("refused", nothing, confidence=sure, doubt=best.doubt, found=found, least=least)
    return Plan(
        "solved",
        best.way,
        confidence=sure,
        doubt=best.doubt,
        edges=best.of_pieces(best.confidence, np.minimum),
        unseen=None if best.unseen is None else best.of_pieces(best.unseen, np.maximum),
        length_rad=best.length_rad,
        found=found,
        least=least,
    )
