"""Learned samples for OMPL's RRT and RRT*, in one's own set-up or with one's own collision checker."""

import math
import time
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from ompl import base as ob
from ompl import geometric as og

from cspace_client.errors import ConfigError, PlanningError
from cspace_client.models import JointSpace, SampleBatch, SampleQuery, Source, circles, configuration
from cspace_client.ompl.sample_mixture import SampleMixture, StateDraws
from cspace_client.ompl.state_space import (
    REACHED_RAD,
    DrawnGoal,
    StateAccess,
    make_state_space,
    read_configuration,
    read_joint_space,
)
from cspace_client.pictures import Picture

DEFAULT_UNIFORM_SHARE = 0.3

_PLANNERS = (og.RRT, og.RRTstar)


@contextmanager
def feed_samples(
    setup: Any,
    samples: Iterable[ArrayLike],
    *,
    uniform_share: float = DEFAULT_UNIFORM_SHARE,
    seed: int = 1,
) -> Iterator[SampleMixture]:
    """Let the planner of an ``ompl.geometric.SimpleSetup`` draw these samples while the block runs.

    The planner draws the goal by its own goal bias, else a sample or, by their share, a uniform state; each
    sample once, in this order, and uniform states after the last one. What counts as reached stays the
    set-up's goal, with its threshold. The value of the block counts: ``learned_drawn`` tells how many samples
    the planner took, ``uniform_drawn`` and ``goal_drawn`` the rest.

    Args:
        setup: with start, goal and planner, RRT or RRT*; its state space is a circle (SO2), a real vector
            space, or a product of these.
        samples: (n, d) values in the order of the state space, an array or anything else that gives rows; for
            circles in rad within three turns of 0.
        uniform_share: share of uniform states among the others while samples are left, 0 to 1.
        seed: of the choice between them, and of the uniform states.

    Raises:
        PlanningError: the planner, the goal or the state space is of another kind, or the samples do not fit
            the state space.
        ConfigError: the uniform share is out of range.
    """
    if not 0.0 <= uniform_share <= 1.0:
        raise ConfigError("uniform_share is out of range", expected="0 to 1", got=repr(uniform_share)[:200])
    planner, goal = setup.getPlanner(), setup.getGoal()
    # InformedRRTstar is an RRTstar, and takes no states from its goal once it has a path.
    if type(planner) not in _PLANNERS:
        names = " or ".join(kind.__name__ for kind in _PLANNERS)
        raise PlanningError("the planner takes no samples", expected=names, got=type(planner).__name__)
    if not isinstance(goal, ob.GoalState):
        raise PlanningError("the goal is no single state", expected="GoalState", got=type(goal).__name__)
    states = setup.getStateSpace()
    space = read_joint_space(states)
    bias = planner.getGoalBias()
    values = read_configuration(states, goal.getState())
    draws = SampleMixture(
        space, values, _rows(samples, space), bias, uniform_share, np.random.default_rng(seed)
    )
    # Copying values into a state needs the state space set up.
    setup.getSpaceInformation().setup()
    setup.setGoal(SetUpGoal(setup, space, values, draws))
    planner.setGoalBias(1.0)
    try:
        yield draws
    finally:
        setup.setGoal(goal)
        planner.setGoalBias(bias)


class SetUpGoal(DrawnGoal):
    """A drawn goal in a state space of the user's own, with that space's distance.

    Args:
        setup: of OMPL, with its goal.
        space: the joint space that its state space is.
        goal: d values of its goal.
        draws: what ``sampleGoal`` gives.
    """

    def __init__(self, setup: Any, space: JointSpace, goal: list[float], draws: StateDraws) -> None:
        information = setup.getSpaceInformation()
        super().__init__(information, space, goal, draws, unlimited=True)
        self._within = max(setup.getGoal().getThreshold(), REACHED_RAD)
        self.setThreshold(self._within)
        # The state space, not the set-up: what OMPL keeps must not lead back to it.
        self._states = setup.getStateSpace()
        self._target = information.allocState()
        self._states.copyFromReals(self._target, goal)

    def distanceGoal(self, state: Any) -> float:  # noqa: N802 - OMPL's name
        """The state space's distance to the real goal."""
        distance = float(self._states.distance(state, self._target))
        if distance <= self._within:
            self._draws.goal_reached()
        return distance

    def sampleGoal(self, state: Any) -> None:  # noqa: N802
        """The next state of the source."""
        self._states.copyFromReals(state, list(self._draws.draw()))


def _rows(samples: Iterable[ArrayLike], space: JointSpace) -> NDArray[np.float64]:
    rows = np.array(list(samples), dtype=np.float64)
    rows = rows if rows.size else np.empty((0, space.dim))
    if rows.ndim != 2 or rows.shape[1] != space.dim or not np.all(np.isfinite(rows)):
        raise PlanningError(
            "the samples do not fit the state space",
            expected=f"finite values of shape (n, {space.dim})",
            got=f"shape {rows.shape}",
        )
    rows = space.clamp(rows)
    beyond = len(rows) - int(np.sum(space.admits(rows)))
    if beyond:
        raise PlanningError(
            "samples lie outside the bounds of the state space",
            expected=f"{space.lower} to {space.upper}",
            got=f"{beyond} others",
            remedy="leave them out; angles are in rad",
        )
    return rows


DEFAULT_SAMPLES = 300
IsFree = Callable[[NDArray[np.float64]], bool]
"""Whether a configuration, (d,) rad, touches nothing."""


@dataclass(frozen=True, slots=True, eq=False)
class Problem:
    """A planning problem whose scene a picture shows.

    Args:
        picture: of the scene, which the samples are drawn from.
        start: (d,) rad.
        goal: (d,) rad.
        is_free: the collision checker; the picture never decides.
    """

    picture: Picture
    start: ArrayLike
    goal: ArrayLike
    is_free: IsFree


@dataclass(frozen=True, slots=True, eq=False)
class Solution:
    """What a search found.

    Args:
        path: (k, d) rad from start to goal; None where none was found in time.
        learned_drawn: learned samples that the planner took.
        uniform_drawn: uniform states likewise.
        goal_drawn: how often it took the goal.
        state_checks: calls of the collision checker.
        solve_time_s: of the search, and of shortening its path.
    """

    path: NDArray[np.float64] | None
    learned_drawn: int
    uniform_drawn: int
    goal_drawn: int
    state_checks: int
    solve_time_s: float


class LearnedSampler:
    """A problem with its samples, ready to be solved, as often as one likes.

    Args:
        problem: that is solved.
        batch: the samples.

    Raises:
        PlanningError: start and goal are no configurations of the samples' robot, or one is not free.
    """

    def __init__(self, problem: Problem, batch: SampleBatch) -> None:
        self.batch, self._is_free = batch, problem.is_free
        self.space: JointSpace = batch.space or circles(batch.samples.shape[1])
        # Limits as single precision has them may lie a little beyond themselves.
        self._samples = self.space.clamp(batch.samples)
        self._ends = [self._end(name, getattr(problem, name)) for name in ("start", "goal")]

    def solve(
        self,
        time_limit_s: float = 10.0,
        *,
        uniform_share: float = DEFAULT_UNIFORM_SHARE,
        range_rad: float = 1.0,
        resolution_rad: float = 0.03,
        seed: int = 1,
    ) -> Solution:
        """Search, and shorten what was found.

        Args:
            time_limit_s: of the search, and again of shortening.
            uniform_share: of uniform states among the samples, 0 to 1; after the last sample all are uniform.
            range_rad: longest step of the tree, in OMPL's metric, the sum over the joints.
            resolution_rad: largest distance between checked states in any joint.
            seed: of what is drawn beside the samples. OMPL's own generators keep their state.

        Raises:
            ConfigError: a value is out of range.
            Exception: whatever the collision checker raised.
        """
        for name, value in (
            ("time_limit_s", time_limit_s),
            ("range_rad", range_rad),
            ("resolution_rad", resolution_rad),
        ):
            if not 0.0 < value < math.inf:
                raise ConfigError(f"{name} is out of range", expected="above 0", got=repr(value)[:200])
        began = time.perf_counter()
        checks = _Checks(self._is_free, self.space)
        setup = self._set_up(checks, range_rad, resolution_rad)
        end = ob.PlannerTerminationCondition(
            lambda: checks.error is not None or time.perf_counter() - began > time_limit_s
        )
        with feed_samples(setup, self._samples, uniform_share=uniform_share, seed=seed) as draws:
            setup.solve(end)
        path = None
        if checks.error is None and setup.haveExactSolutionPath():
            setup.simplifySolution(time_limit_s)
            path = checks.access.rows(setup.getSolutionPath().getStates())
        if checks.error is not None:
            error, checks.error = checks.error, None
            raise error
        counts = draws.learned_drawn, draws.uniform_drawn, draws.goal_drawn, checks.count
        return Solution(path, *counts, time.perf_counter() - began)

    def _set_up(self, checks: "_Checks", range_rad: float, resolution_rad: float) -> Any:
        states = make_state_space(self.space)
        setup = og.SimpleSetup(states)
        information = setup.getSpaceInformation()
        setup.setStateValidityChecker(checks)
        # A share of each joint's range.
        widest = max(part.getMaximumExtent() for part in states.getSubspaces())
        information.setStateValidityCheckingResolution(resolution_rad / widest)
        ends = [information.allocState() for _ in self._ends]
        for state, values in zip(ends, self._ends, strict=True):
            checks.access.write(state, values)
        setup.setStartAndGoalStates(*ends)
        planner = og.RRT(information)
        planner.setRange(range_rad)
        setup.setPlanner(planner)
        return setup

    def _end(self, name: str, given: ArrayLike) -> list[float]:
        values = np.asarray(given, dtype=np.float64)
        fits = values.shape == (self.space.dim,) and np.isfinite(values).all()
        if fits:
            values = self.space.clamp(values)
        if not (fits and self.space.admits(values)):
            raise PlanningError(
                f"the {name} is no configuration of this robot",
                expected=f"{self.space.dim} joints in rad within their limits",
                got=str(values)[:200],
                remedy="send angles in rad, and name a model of this robot",
            )
        values = self.space.wrap(values)
        if not self._is_free(values.copy()):
            raise PlanningError(f"the {name} is not free", got=str(values)[:200])
        return [float(value) for value in values]


def learned_sampler(
    problem: Problem,
    client: Source,
    *,
    n: int = DEFAULT_SAMPLES,
    seed: int | None = None,
    model: str | None = None,
    with_ends: bool = False,
) -> LearnedSampler:
    """The samples of a problem, all asked for before the search, for OMPL lets nothing else run during it.

    Args:
        problem: that is to be solved.
        client: :class:`cspace_client.SamplingClient`, or a :class:`cspace_client.local.LocalClient`.
        n: how many samples.
        seed: of the samples; drawn when None.
        model: as :meth:`cspace_client.SamplingClient.sample` has it.
        with_ends: whether start and goal are sent, as path models require and others refuse.

    Raises:
        SamplerError: as the client has it.
        PlanningError: start and goal are no configurations of the samples' robot, or one is not free.
    """
    query = SampleQuery.of(n, seed)
    if with_ends:
        start, goal = configuration("start", problem.start), configuration("goal", problem.goal)
        query = replace(query, start=start, goal=goal)
    return LearnedSampler(problem, client.answer(problem.picture, query, model))


class _Checks:
    """The collision checker as OMPL calls it. An error of it ends the search instead of OMPL.

    Args:
        is_free: the checker.
        space: the joint space.
    """

    def __init__(self, is_free: IsFree, space: JointSpace) -> None:
        self.count = 0
        self.error: Exception | None = None
        self.access = StateAccess(space)
        self._is_free, self._dim = is_free, space.dim

    def __call__(self, state: Any) -> bool:
        self.count += 1
        values = np.empty(self._dim)
        self.access.read(state, values)
        # A traceback that kept it beyond OMPL's own state would pass for the next state at its address.
        del state
        try:
            return self.error is None and bool(self._is_free(values))
        except Exception as error:  # noqa: BLE001 - it is raised once OMPL has returned
            self.error = error
            return False
