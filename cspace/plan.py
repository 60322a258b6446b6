"""Plans a path from start to goal through what a picture shows, by what a model predicts of the rest."""

import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cspace.planning.cost import Predict, ScoredPath, given_free, score
from cspace.planning.paths import spaced
from cspace.planning.refine import Effort, PathRefiner, cheapest_route
from cspace.planning.rrt_connect import Growth, grow_connect
from cspace.planning.search import SearchLimits, find_paths, with_deadline
from cspace.planning.trajectory import timed
from cspace.query import Plan, PlanQuery, Trajectory
from cspace.simulator import Checker
from cspace.space import LIMIT_TOLERANCE_RAD, JointSpace
from cspace.world import CheckCancelled, Contact, Image, Known, World
from cspace.worlds import (
    WITH_TOOL,
    examples,
    load_known,
    seen_checkers,
    tool_constraints,
    unseen_space,
)


def load_kernels(checker: Checker, configuration: NDArray[np.float64], step_rad: float) -> None:
    """Have the compiled code of a checker of any scene in this process: a first call loads or compiles it."""
    checker.valid_batch(configuration[None])
    checker.edge_batch(configuration[None], configuration[None], step_rad)
    grow_connect(checker, configuration, configuration, configuration[None], Growth(step_rad, step_rad))
    cheapest_route(np.zeros((1, 1)), 0, 0)


def load_examples() -> None:
    """Have the compiled code of the worlds of every kind in this process."""
    for world in examples().values():
        nothing = np.zeros(world.sensor.picture_shape, dtype=np.uint8)
        ends = np.zeros((2, world.dim))
        checkers = seen_checkers(world, nothing, ends)
        load_kernels(checkers[0], ends[0], 0.1)
        load_known(world)
        if world.kind in WITH_TOOL:
            goal_pose, upright = {"pose": np.eye(4).tolist()}, {"axis": [0, 0, 1], "max_rad": np.pi}
            _constrained(world, checkers, ends, PlanQuery((), None, goal_pose=goal_pose))
            turned, _, _ = _constrained(world, checkers, ends, PlanQuery((), None, upright=upright))
            load_kernels(turned[0], ends[0], 0.1)


# Between states that the model is asked about.
STEP_RAD = 0.15
# Between states of a path that are checked against known bodies, beside which no margin is left.
_KNOWN_STEP_RAD = 0.01
# Paths that are looked for in a careful world, and the effort, most of which is in vain where there are none.
CAREFUL_PATHS, CAREFUL = 2, SearchLimits(states=1024, first=1024)
# Configurations that bring the tool to a goal, which paths are searched to.
MAX_GOALS = 4
# Confidence below which a configuration is expected to touch something.
_LIKELY = 0.5
# Configurations through one of which a crossing of what is in the way may lead.
_CROSSINGS = 32
# Of an angle at an end, which came in single precision.
_ROUNDED_RAD = 1e-6


@dataclass(frozen=True, slots=True, eq=False)
class Seen:
    """A scene as a model knows it."""

    world: World
    picture: Image
    predict: Predict  # what the model says of configurations
    plan_calibration: tuple[float, float] = (0.0, 1.0)  # (a, b), see :mod:`cspace.planning.cost`
    known: Known | None = None  # beside the picture
    occupancy: NDArray[np.float16] | None = None  # (X, Y, Z), probability of each voxel, where a model tells

    def beside(self, unseen: Any, predict: Predict) -> Predict:
        """``predict`` times the chance that nothing is touched in the unseen space of a model's occupancy."""

        def both(rows: NDArray[np.float32]) -> tuple[NDArray[np.float32], NDArray[np.float32] | None]:
            confidence, share = predict(rows)
            clear = 1.0 - unseen.touched(rows)
            if self.known is not None:
                clear[self.known.certain(rows, lambda: None)] = 1.0
            return confidence * clear, share

        return both


@dataclass(frozen=True, slots=True, eq=False)
class Searched:
    """Paths through what a picture shows."""

    paths: list[ScoredPath]  # lowest cost first
    late: bool  # whether the time was over before there were as many as were wanted
    search_ms: float
    score_ms: float  # asking the model about them, and refining them
    reason: str | None = None  # why nothing was looked for, in words; None where something was
    checker: Checker | None = None  # by which the paths are free; None without paths


def plan(
    seen: Seen, ends: NDArray[np.float64], query: PlanQuery, check_cancelled: CheckCancelled | None = None
) -> Plan:
    """The path of lowest cost; without ``min_confidence`` any confidence is enough.

    ``ends``: (2, d) rad, the query's start and goal as the model takes them; (1, d) where it has no goal.
    """
    least = query.min_confidence or 0.0
    searched = search_paths(seen, ends, query, check_cancelled)
    if searched.paths:
        best = searched.paths[0]
        found = _answer(best, len(searched.paths), least)
        if found.status != "solved":
            # The robot stands at its start.
            found = replace(
                found, reason=_blocked_end(seen, {"goal": ends[-1]} if len(ends) > 1 else {}, query)
            )
        if query.alternatives:
            alternatives = tuple(one.alternative() for one in searched.paths if one.whole >= least)
            found = replace(found, alternatives=alternatives)
    else:
        nothing = np.empty((0, seen.world.dim))
        named = dict(zip(("start", "goal"), ends, strict=False))
        reason = searched.reason or _blocked_end(seen, named, query)
        found = Plan("timeout" if searched.late else "refused", nothing, reason=reason)
    if found.status != "solved" and (query.explain or seen.known is not None):
        found = replace(found, contact=_contact(seen, ends, found, query))
    space = planning_space(seen.world, query.limits)
    start = np.where(space.periodic, ends[0], query.start)
    if np.abs(start - ends[0]).max() > LIMIT_TOLERANCE_RAD and len(found.path):
        # The first edge leads back to the limit.
        length_rad = found.length_rad + float(np.linalg.norm(start - found.path[0]))
        found = _changed(
            found,
            lambda rows: np.vstack([start, rows]),
            lambda values: np.pad(values, (1, 0), mode="edge"),
            length_rad,
        )
    elif len(ends) > 1 and np.array_equal(*ends):
        # The arm stays where it stands.
        found = _changed(found, lambda rows: rows[:1], lambda values: values[:0], 0.0)
        found = replace(found, alternatives=found.alternatives[:1])
    if found.status == "solved" and searched.checker is not None:
        found = replace(found, trajectory=_trajectory(seen, found, query, searched.checker))
    if query.unwrapped:
        others = (replace(one, path=space.unwrap(one.path, query.start)) for one in found.alternatives)
        found = replace(found, path=space.unwrap(found.path, query.start), alternatives=tuple(others))
    return replace(found, search_ms=searched.search_ms, score_ms=searched.score_ms)


def _trajectory(seen: Seen, found: Plan, query: PlanQuery, checker: Checker) -> Trajectory | None:
    """The plan's path in time; None where no limits of velocity and acceleration are known."""
    velocity, acceleration = seen.world.motion_limits
    velocity = query.max_velocity_rad_s or velocity
    acceleration = query.max_acceleration_rad_s2 or acceleration
    if velocity is None or acceleration is None:
        return None

    def are_free(rows: NDArray[np.float64]) -> NDArray[np.bool_]:
        free = checker.valid_batch(rows)
        return free if seen.known is None else free & seen.known.free(rows)

    trajectory = timed(found.path, checker.space, velocity, acceleration, are_free)
    from_start = np.round((query.start - trajectory.positions[0]) / (2.0 * np.pi)) * (2.0 * np.pi)
    return replace(
        trajectory, positions=trajectory.positions + np.where(checker.space.periodic, from_start, 0.0)
    )


def _blocked_end(seen: Seen, ends: Mapping[str, NDArray[np.float64]], query: PlanQuery) -> str | None:
    """What start or goal touches, for certain or as the model expects, in words; None where neither does."""
    contacts = {name: seen.world.contact(end, seen.picture, seen.known) for name, end in ends.items()}
    for kinds in (("known", "self"), ("seen",)):
        for name, one in contacts.items():
            if one is not None and one.kind in kinds:
                off = "; is state where the arm was?" if (name, one.kind) == ("start", "seen") else ""
                return f"at the {name} {one.text}{off}"
    if "goal" in ends and not query.goal_free:
        confidence, _ = seen.predict(seen.world.space.to_float32(ends["goal"][None]))
        if confidence[0] < _LIKELY:
            where = "" if contacts["goal"] is None else f": {contacts['goal'].text}"
            return f"the goal is expected to touch something, with a confidence of {confidence[0]:.2f}{where}"
    return None


def _crossing(seen: Seen, ends: NDArray[np.float64], query: PlanQuery) -> Contact | None:
    """What is at the tightest place of the shallowest path, straight or by one configuration."""
    checker = seen_checkers(seen.world, seen.picture, ends, seen.known)[-1]
    space = planning_space(seen.world, query.limits)
    by = space.sample_uniform(np.random.default_rng([query.seed, 3]), _CROSSINGS)
    paths = [ends, *(np.stack([ends[0], one, ends[1]]) for one in by)]
    states = [spaced(path, space, STEP_RAD) for path in paths]
    clearances = [checker.clearance(rows) for rows in states]
    best = int(np.argmax([np.minimum(one, 0.0).sum() for one in clearances]))
    tightest = states[best][int(np.argmin(clearances[best]))]
    return seen.world.contact(tightest, seen.picture, seen.known)


def _contact(seen: Seen, ends: NDArray[np.float64], found: Plan, query: PlanQuery) -> Contact | None:
    """What is in the way of start or goal if they touch something for certain, else of the tightest place."""
    for end in ends:
        contact = seen.world.contact(end, seen.picture, seen.known)
        # Pictures may show the robot itself there, so that surfaces at the ends are not held against them.
        if contact is not None and contact.kind in ("known", "self"):
            return contact
    if found.least is not None:
        return seen.world.contact(found.least.configuration, seen.picture, seen.known)
    is_between = found.reason is None and query.explain and len(ends) > 1
    return _crossing(seen, ends, query) if is_between else None


def search_paths(
    seen: Seen, ends: NDArray[np.float64], query: PlanQuery, check_cancelled: CheckCancelled | None = None
) -> Searched:
    """Up to so many paths from ``ends[0]`` to ``ends[1]``, scored; (1, d) ``ends`` where a pose is the goal.

    The query's time is of computing, for the search; where it does not run out, it changes no path.
    """
    checkers = seen_checkers(seen.world, seen.picture, ends, seen.known)
    # Before the time counts.
    load_kernels(checkers[0], ends[0], STEP_RAD)
    began = time.monotonic()
    until_s = time.thread_time() + query.time_limit_s
    careful, unseen = 0, None
    if seen.occupancy is not None:
        unseen = unseen_space(seen.world, seen.picture, seen.occupancy, ends, seen.known)
        checkers, careful = [unseen.careful_checker(), *checkers], 1
    checkers, goals, reason = _constrained(seen.world, checkers, ends, query)
    if reason is not None:
        took_ms = 1e3 * (time.monotonic() - began)
        return Searched([], late=False, search_ms=took_ms, score_ms=0.0, reason=reason)
    # The model takes circles in [-pi, pi).
    own = seen.world.space
    predict = seen.predict if query.limits is None else lambda rows: seen.predict(own.to_float32(rows))
    if unseen is not None:
        predict = seen.beside(unseen, predict)
    search = partial(find_paths, start=ends[0], goal=goals, seed=query.seed, until_s=until_s)
    found = search(checkers[careful:], count=query.ways, check_cancelled=check_cancelled)
    paths = found.paths
    if paths and careful:
        # The ways that a careful robot would take, if there are any.
        more = search(
            checkers[:careful], count=CAREFUL_PATHS, limits=CAREFUL, check_cancelled=check_cancelled
        )
        paths = [*more.paths, *paths]
    searched = time.monotonic()
    space = checkers[0].space
    # The robot stands at its start.
    predict = given_free(predict, space, ends if query.goal_free else ends[:1])
    ranked = _ranked(score(paths, space, STEP_RAD, predict, seen.plan_calibration), space, seen.known)
    if found.checker is not None:
        check_cancelled = with_deadline(until_s, check_cancelled)
        effort = Effort(step_rad=STEP_RAD)
        refiner = PathRefiner(found.checker, predict, seen.plan_calibration, effort, check_cancelled)
        ranked[: effort.paths] = [
            refiner.refine(path, np.random.default_rng([query.seed, number, 1]))
            for number, path in enumerate(ranked[: effort.paths])
        ]
        ranked = _ranked(ranked, space, seen.known)
    scored_ms = 1e3 * (time.monotonic() - searched)
    reason = None if ranked or not paths else "each path that was found touches a known body"
    return Searched(ranked, found.late, 1e3 * (searched - began), scored_ms, reason, found.checker)


def planning_space(world: World, limits: Sequence[Sequence[float] | None] | None) -> JointSpace:
    """The joint space that a query's paths lie in."""
    return world.space if limits is None else world.space.narrowed(limits)


def _constrained(
    world: World, checkers: Sequence[Checker], ends: NDArray[np.float64], query: PlanQuery
) -> tuple[Sequence[Checker], NDArray[np.float64], str | None]:
    """Checkers that hold a query's constraints, and its goals (g, d) rad; or why there can be no path."""
    goals, space = ends[1:], planning_space(world, query.limits)
    if query.limits is not None:
        checkers = [one.within(space) for one in checkers]
    tool = tool_constraints(world, query.goal_pose, query.upright)
    if tool is None:
        return checkers, goals, None
    if query.goal_pose is not None:
        goals = tool.goals(space, np.random.default_rng([query.seed, 2]))
        if not len(goals):
            return checkers, goals, f"the tool cannot reach {tool.reach}, within the joints' limits"
    if query.upright is not None:
        for name, rows in (("start", ends[:1]), ("the goal", goals)):
            least = float(tool.angles_rad(rows).min())
            if least > tool.max_rad + _ROUNDED_RAD:
                reason = (
                    f"{name} breaks upright: the axis is {least:.3f} rad from up, above {tool.max_rad:g} rad"
                )
                return checkers, goals, reason
        goals = goals[tool.angles_rad(goals) <= tool.max_rad + _ROUNDED_RAD]
        checkers = tool.upright(checkers, np.concatenate([ends[:1], goals]))
    if query.goal_pose is not None:
        goals = goals[checkers[-1].valid_batch(goals)]
        if not len(goals):
            reason = "each configuration found for goal_pose touches the robot, a known body or what is seen"
            return checkers, goals, reason
        nearest = np.argsort(space.distance(ends[0], goals), kind="stable")
        goals = goals[nearest[:MAX_GOALS]]
    return checkers, goals, None


def _changed(
    found: Plan,
    points: Callable[[NDArray[np.float64]], NDArray[np.float64]],
    edges: Callable[[NDArray[np.float32]], NDArray[np.float32]],
    length_rad: float,
) -> Plan:
    """The plan with other points and values of edges."""
    others = (replace(one, path=points(one.path), edges=edges(one.edges)) for one in found.alternatives)
    return replace(
        found,
        path=points(found.path),
        edges=edges(found.edges),
        unseen=None if found.unseen is None else edges(found.unseen),
        length_rad=length_rad,
        alternatives=tuple(others),
    )


def _ranked(paths: Iterable[ScoredPath], space: JointSpace, known: Known | None) -> list[ScoredPath]:
    """Lowest cost first.

    Where something is known, without paths that touch it between the states of the search; of those that are
    known to be free, and so have no cost, the shortest is first.
    """
    if known is None:
        return sorted(paths, key=lambda one: one.cost)
    free = [one for one in paths if known.free(spaced(one.path, space, _KNOWN_STEP_RAD)).all()]
    return sorted(free, key=lambda one: (one.cost, one.length_rad))


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


if __name__ == "__main__":
    load_examples()
