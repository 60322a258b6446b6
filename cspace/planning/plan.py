"""A way from start to goal in what a model believes of a picture, or the reason why there is none.

Ways are searched for through what the picture shows, where all that it does not show is free; the model is
asked about them, and the one that it doubts least is taken.
"""

import time
from dataclasses import replace

import numpy as np

from cspace.bundle import Bundle, Picture
from cspace.bundle.request import fitted_end
from cspace.connecting import Between
from cspace.planning.compiled import load_kernels
from cspace.planning.query import Plan, PlanQuery
from cspace.planning.scoring import ScoredWay, score
from cspace.planning.ways import find_ways
from cspace.worlds import best_view, seen_checkers

# Between states that the model is asked about.
STEP_RAD = 0.15


def plan(bundle: Bundle, picture: Picture, query: PlanQuery, between: Between | None = None) -> Plan:
    """Plan.

    Args:
        bundle: with a validity head.
        picture: that the bundle has prepared.
        query: the problem.
        between: called now and then; may raise to stop, which passes through.

    Raises:
        InputError: the bundle has no validity head, or start or goal does not fit the robot.
        BundleError: a graph fails.
        ImportError: the compiler of the checks is not installed.
    """
    space = bundle.spec.world.space
    given = (("start", query.start), ("goal", query.goal))
    ends = np.asarray([fitted_end(bundle.spec, name, end) for name, end in given], dtype=np.float64)
    world = bundle.spec.world
    shown = world.sensor.from_network(picture.pixels)[0]
    checkers = seen_checkers(world, shown, ends)
    # Before the time counts.
    load_kernels(checkers[0], ends[0], STEP_RAD)
    began = time.monotonic()
    until_s = began + query.time_limit_s
    ways, late = find_ways(checkers, ends[0], ends[1], query.ways, query.seed, until_s, between=between)
    searched = time.monotonic()
    calibrated = bundle.spec.plan_doubt or (0.0, 1.0)
    scored = score(ways, space, STEP_RAD, lambda rows: bundle.believe(picture, rows, between), calibrated)
    ended = time.monotonic()
    if scored:
        ranked = sorted(scored, key=lambda one: one.doubt)
        best = ranked[0]
        found = _answer(best, len(scored), query.min_confidence)
        if query.alternatives:
            sure = tuple(one.believed() for one in ranked if one.whole >= query.min_confidence)
            found = replace(found, alternatives=sure)
        if query.next_view:
            pause = between or (lambda: None)
            view = best_view(world, shown, best.states, best.doubts, query.views, pause)
            found = replace(found, next_view=view)
    else:
        found = Plan("timeout" if late else "refused", np.empty((0, space.dim)))
    return replace(found, search_ms=1e3 * (searched - began), score_ms=1e3 * (ended - searched))


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
