"""Plans a path from start to goal through what a picture shows, by what a model predicts of the rest."""

import math
import sys
import time
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from cspace.planning.cost import Predict, ScoredPath, score
from cspace.planning.refine import Effort, PathRefiner, route_search
from cspace.planning.rrt_connect import CheckCancelled, connect_trees
from cspace.planning.search import find_paths, with_deadline
from cspace.query import Plan, PlanQuery
from cspace.simulator import Checker
from cspace.world import Contact, Image, Known, World
from cspace.worlds import best_view, examples, load_known, seen_checkers


def load_kernels(checker: Checker, configuration: NDArray[np.float64], step_rad: float) -> None:
    """Have a checker's compiled code in this process: a first call loads it, or compiles it.

    Args:
        checker: of any scene.
        configuration: (d,) rad.
        step_rad: above 0.
    """
    checker.valid_batch(configuration[None])
    checker.edge_batch(configuration[None], configuration[None], step_rad)
    ends = configuration, configuration
    connect_trees(checker, *ends, configuration[None], range_rad=step_rad, resolution_rad=step_rad)
    route_search()(np.zeros((1, 1)), 0, 0)


def load_examples() -> list[str]:
    """Have the compiled code of the worlds of every kind in this process; returns the examples' names."""
    for world in examples().values():
        nothing = np.zeros(world.sensor.picture_shape, dtype=np.uint8)
        ends = np.zeros((2, world.dim))
        load_kernels(seen_checkers(world, nothing, ends)[0], ends[0], 0.1)
        load_known(world)
    return list(examples())


def main() -> int:
    """Compile for every example; returns the exit code."""
    sys.stdout.write(f"compiled for {', '.join(load_examples())}\n")
    return 0


if __name__ == "__main__":
    sys.exit(main())


# Between states that the model is asked about.
STEP_RAD = 0.15


@dataclass(frozen=True, slots=True, eq=False)
class Seen:
    """A scene as a model knows it.

    Args:
        world: the robot and how it is seen.
        picture: of the scene.
        predict: what the model says of configurations in it.
        plan_calibration: (a, b), see :mod:`cspace.planning.cost`.
        known: of it beside the picture.
    """

    world: World
    picture: Image
    predict: Predict
    plan_calibration: tuple[float, float] = (0.0, 1.0)
    known: Known | None = None


@dataclass(frozen=True, slots=True, eq=False)
class Searched:
    """Paths through what a picture shows.

    Args:
        paths: lowest cost first.
        late: whether the time was over before there were as many as were wanted.
        search_ms: looking for them.
        score_ms: asking the model about them, and changing them until their cost is lower.
    """

    paths: list[ScoredPath]
    late: bool
    search_ms: float
    score_ms: float


def plan(
    seen: Seen, ends: NDArray[np.float64], query: PlanQuery, check_cancelled: CheckCancelled | None = None
) -> Plan:
    """Plan.

    Args:
        seen: the scene.
        ends: (2, d) rad, the query's start and goal as the model takes them.
        query: the problem; without ``min_confidence`` any confidence is enough.
        check_cancelled: called now and then; may raise to stop, which passes through.

    Raises:
        InputError: one of the query's views is no camera, or one that the picture is from has no pose.
        ImportError: the compiler of the checks is not installed.
    """
    least = query.min_confidence or 0.0
    searched = search_paths(seen, ends, query.ways, query.seed, query.time_limit_s, check_cancelled)
    if searched.paths:
        best = searched.paths[0]
        found = _answer(best, len(searched.paths), least)
        if query.alternatives:
            alternatives = tuple(one.alternative() for one in searched.paths if one.whole >= least)
            found = replace(found, alternatives=alternatives)
        if query.next_view:
            check_cancelled = check_cancelled or (lambda: None)
            view = best_view(
                seen.world,
                seen.picture,
                best.states,
                best.costs,
                query.views,
                check_cancelled,
                query.seen_by,
                query.seen_state,
            )
            found = replace(found, next_view=view)
    else:
        found = Plan("timeout" if searched.late else "refused", np.empty((0, seen.world.dim)))
    if found.status != "solved" and (query.explain or seen.known is not None):
        found = replace(found, contact=_contact(seen, ends, found))
    return replace(found, search_ms=searched.search_ms, score_ms=searched.score_ms)


def _contact(seen: Seen, ends: NDArray[np.float64], found: Plan) -> Contact | None:
    """What is in the way of start or goal if they touch something for certain, else of the tightest place."""
    for end in ends:
        contact = seen.world.contact(end, seen.picture, seen.known)
        # Pictures may show the robot itself there, so that surfaces at the ends are not held against them.
        if contact is not None and contact.kind in ("known", "self"):
            return contact
    return (
        None
        if found.least is None
        else seen.world.contact(found.least.configuration, seen.picture, seen.known)
    )


def search_paths(
    seen: Seen,
    ends: NDArray[np.float64],
    count: int,
    seed: int,
    time_limit_s: float = math.inf,
    check_cancelled: CheckCancelled | None = None,
) -> Searched:
    """Up to so many paths from ``ends[0]`` to ``ends[1]``, scored.

    Args:
        seen: the scene.
        ends: (2, d) rad.
        count: of paths.
        seed: of all draws.
        time_limit_s: of computing, for the search; without one the paths depend on nothing but the rest.
        check_cancelled: called now and then; may raise to stop, which passes through.

    Raises:
        ImportError: the compiler of the checks is not installed.
    """
    checkers = seen_checkers(seen.world, seen.picture, ends, seen.known)
    # Before the time counts.
    load_kernels(checkers[0], ends[0], STEP_RAD)
    began = time.monotonic()
    until_s = time.thread_time() + time_limit_s
    found = find_paths(checkers, ends[0], ends[1], count, seed, until_s, check_cancelled=check_cancelled)
    searched = time.monotonic()
    scored = score(found.paths, seen.world.space, STEP_RAD, seen.predict, seen.plan_calibration)
    ranked = sorted(scored, key=_by_cost)
    if found.checker is not None:
        check_cancelled = with_deadline(until_s, check_cancelled)
        refiner = PathRefiner(
            found.checker, seen.predict, seen.plan_calibration, Effort(step_rad=STEP_RAD), check_cancelled
        )
        ranked = _refined(ranked, refiner, seed)
    return Searched(ranked, found.late, 1e3 * (searched - began), 1e3 * (time.monotonic() - searched))


def _refined(ranked: list[ScoredPath], refiner: PathRefiner, seed: int) -> list[ScoredPath]:
    """The paths, the first of them changed."""
    changed = ranked[: refiner.effort.paths]
    found = [
        refiner.refine(path, np.random.default_rng([seed, number, 1])) for number, path in enumerate(changed)
    ]
    return sorted([*found, *ranked[len(changed) :]], key=_by_cost)


def _by_cost(path: ScoredPath) -> float:
    return path.cost


def _answer(best: ScoredPath, found: int, min_confidence: float) -> Plan:
    least, confidence = best.least(), best.whole
    if confidence < min_confidence:
        nothing = np.empty((0, best.path.shape[1]))
        return Plan("refused", nothing, confidence=confidence, cost=best.cost, found=found, least=least)
    return Plan(
        "solved",
        best.path,
        confidence=confidence,
        cost=best.cost,
        edges=best.of_pieces(best.confidence, np.minimum),
        unseen=None if best.unseen is None else best.of_pieces(best.unseen, np.maximum),
        length_rad=best.length_rad,
        found=found,
        least=least,
    )
