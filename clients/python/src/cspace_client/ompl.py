"""Learned samples for OMPL's RRT and RRT*: for your own set-up, or for a problem with your own checker.

OMPL's Python binding cannot replace a planner's state sampler. Its planners ask a sampleable goal for
states, though, with a probability (the goal bias) that may be 1. So the learned samples, the uniform ones and
the goal itself all come through ``sampleGoal``; what counts as reached is still the real goal alone.
"""

import math
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray
from ompl import base as ob
from ompl import geometric as og

from cspace_client.answers import Joints, JointSpace, SampleBatch, as_query, circles, seeded
from cspace_client.client import SamplingClient
from cspace_client.errors import ConfigError, PlanningError
from cspace_client.pictures import Picture
from cspace_client.wire import SampleQuery

DEFAULT_UNIFORM_SHARE, DEFAULT_SAMPLES = 0.3, 300
REACHED_RAD = 1e-9
_PLANNERS = (og.RRT, og.RRTstar)
_UNLIMITED = 2**31 - 1
_BLOCK = 256


class StateDraws(Protocol):
    """A source of states for a planner, which counts what it gave."""

    goal_drawn: int
    learned_drawn: int
    uniform_drawn: int

    def draw(self) -> Sequence[float]:
        """The next configuration, d values in rad."""
        ...

    def goal_reached(self) -> None:
        """The tree has reached the goal."""
        ...


class SampleMixture:
    """Draws the goal by its bias, else a learned sample or, by their share, a uniform one.

    The learned samples come in the order given and once each, as ``BiasSampler[i]`` in algorithm 3 of the
    MultiWGAN-GP paper; after the last one all further states are uniform.
    """

    def __init__(
        self,
        space: Joints,
        goal: Sequence[float],
        samples: NDArray[np.float64],
        goal_bias: float,
        uniform_share: float,
        rng: np.random.Generator,
    ) -> None:
        self.goal_drawn = self.learned_drawn = self.uniform_drawn = 0
        self._space, self._rng = space, rng
        self._goal, self._goal_bias = goal, goal_bias
        wrapped: list[list[float]] = space.wrap(samples).tolist()
        self._count = len(wrapped)
        self._samples = iter(wrapped)
        self._uniform_share = uniform_share
        # Drawn in blocks: one call of numpy for each state would cost more than checking its edge.
        self._choices: list[list[float]] = []
        self._uniform: list[list[float]] = []

    def draw(self) -> Sequence[float]:
        """The next configuration, d values in rad."""
        if not self._choices:
            self._choices = self._rng.random((_BLOCK, 2)).tolist()
        for_goal, for_uniform = self._choices.pop()
        if for_goal < self._goal_bias:
            self.goal_drawn += 1
            return self._goal
        if self.learned_drawn < self._count and for_uniform >= self._uniform_share:
            self.learned_drawn += 1
            return next(self._samples)
        if not self._uniform:
            self._uniform = self._space.sample_uniform(self._rng, _BLOCK).tolist()
        self.uniform_drawn += 1
        return self._uniform.pop()

    def goal_reached(self) -> None:
        """No goal is drawn from now on, as in OMPL's own RRT* with a single goal state."""
        self._goal_bias = 0.0


def make_state_space(space: Joints) -> Any:
    """OMPL's product space of a joint space: SO(2) for a circle, a real interval for a limited joint."""
    product = ob.CompoundStateSpace()
    for low, high, periodic in zip(space.lower, space.upper, space.periodic, strict=True):
        if periodic:
            product.addSubspace(ob.SO2StateSpace(), 1.0)
        else:
            interval = ob.RealVectorStateSpace(1)
            interval.setBounds(low, high)
            product.addSubspace(interval, 1.0)
    return product


class StateAccess:
    """Copies OMPL's states to floats and back; a state that a callback was given must not outlive it."""

    def __init__(self, space: Joints) -> None:
        self.dim = space.dim
        self._circles = [joint for joint in range(space.dim) if space.periodic[joint]]
        self._intervals = [joint for joint in range(space.dim) if not space.periodic[joint]]

    def read(self, state: Any, into: NDArray[np.float64]) -> None:
        """Copies a state into (d,) rad."""
        for joint in self._circles:
            into[joint] = state[joint].value
        for joint in self._intervals:
            into[joint] = state[joint][0]

    def write(self, state: Any, values: Sequence[float]) -> None:
        """Copies d values in rad into a state."""
        for joint in self._circles:
            state[joint].value = values[joint]
        for joint in self._intervals:
            state[joint][0] = values[joint]

    def rows(self, states: Sequence[Any]) -> NDArray[np.float64]:
        """Copies of states as (N, d) rad."""
        out = np.empty((len(states), self.dim))
        for row, state in zip(out, states, strict=True):
            self.read(state, row)
        return out


def read_joint_space(states: Any) -> JointSpace:
    """The joint space that an OMPL state space is: SO2, real vector spaces, or a product of these."""
    sides: list[tuple[float, float, bool]] = []
    for part in _parts(states):
        if isinstance(part, ob.SO2StateSpace):
            sides.append((-math.pi, math.pi, True))
        elif isinstance(part, ob.RealVectorStateSpace):
            bounds = part.getBounds()
            sides += [(low, high, False) for low, high in zip(bounds.low, bounds.high, strict=True)]
        else:
            raise PlanningError(
                "the state space is of another kind",
                expected="SO2, real vector spaces, or a product of these",
                got=type(part).__name__,
            )
    lower, upper, periodic = zip(*sides, strict=True)
    return JointSpace(lower, upper, periodic)


def read_configuration(states: Any, state: Any) -> list[float]:
    """A state of such a space as values in the order of its joints."""
    # The binding's copyToReals fills a copy of the list that it is given.
    compound = isinstance(states, ob.CompoundStateSpace)
    values: list[float] = []
    for index, part in enumerate(_parts(states)):
        piece = state[index] if compound else state
        circle = isinstance(part, ob.SO2StateSpace)
        values += [piece.value] if circle else [piece[axis] for axis in range(part.getDimension())]
    return values


def _parts(states: Any) -> list[Any]:
    return list(states.getSubspaces()) if isinstance(states, ob.CompoundStateSpace) else [states]


class DrawnGoal(ob.GoalSampleableRegion):  # type: ignore[misc]
    """A goal whose states come from a source of draws, with the state space's own distance to the real goal.

    The state space is set up already. With ``unlimited`` the source has more than the goal to give; without
    it OMPL treats the region as it treats a single goal state.
    """

    def __init__(
        self,
        information: Any,
        goal: Sequence[float],
        draws: StateDraws,
        *,
        within: float = REACHED_RAD,
        unlimited: bool = True,
    ) -> None:
        super().__init__(information)
        self.setThreshold(within)
        # The state space, not the set-up: what OMPL keeps must not lead back to it.
        self._states, self._target = information.getStateSpace(), information.allocState()
        self._states.copyFromReals(self._target, [float(value) for value in goal])
        self._draws, self._within = draws, within
        self._limit = _UNLIMITED if unlimited else 1

    def distanceGoal(self, state: Any) -> float:  # noqa: N802 - OMPL's name
        """The state space's distance to the real goal."""
        distance = float(self._states.distance(state, self._target))
        if distance <= self._within:
            self._draws.goal_reached()
        return distance

    def sampleGoal(self, state: Any) -> None:  # noqa: N802
        """The next state of the source."""
        self._states.copyFromReals(state, list(self._draws.draw()))

    def maxSampleCount(self) -> int:  # noqa: N802
        """How many states may be asked for."""
        return self._limit

    def couldSample(self) -> bool:  # noqa: N802
        """Always."""
        return True


@contextmanager
def feed_samples(
    setup: Any,
    samples: Iterable[ArrayLike],
    *,
    uniform_share: float = DEFAULT_UNIFORM_SHARE,
    seed: int = 1,
) -> Iterator[SampleMixture]:
    """Lets the planner of an ``ompl.geometric.SimpleSetup`` draw these samples while the block runs.

    The planner draws the goal by its own goal bias, else a sample or, by their share, a uniform state; each
    sample once, in this order, and uniform states after the last one. What counts as reached stays the
    set-up's goal, with its threshold. The value of the block counts: ``learned_drawn`` says how many samples
    the planner took, ``uniform_drawn`` and ``goal_drawn`` the rest.

    Args:
        setup: with start, goal and planner, RRT or RRT*; its state space is a circle (SO2), a real vector
            space, or a product of these.
        samples: (n, d) values in the order of the state space; for circles in rad within three turns of 0.
        uniform_share: share of uniform states among the others while samples are left, 0 to 1.
        seed: of the choice between them, and of the uniform states.
    """
    if not 0.0 <= uniform_share <= 1.0:
        raise ConfigError("uniform_share is out of range", expected="0 to 1", got=repr(uniform_share))
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
    rng = np.random.default_rng(seed)
    draws = SampleMixture(space, values, _rows(samples, space), bias, uniform_share, rng)
    # Copying values into a state needs the state space set up.
    information = setup.getSpaceInformation()
    information.setup()
    within = max(goal.getThreshold(), REACHED_RAD)
    setup.setGoal(DrawnGoal(information, values, draws, within=within))
    planner.setGoalBias(1.0)
    try:
        yield draws
    finally:
        setup.setGoal(goal)
        planner.setGoalBias(bias)


def _rows(samples: Iterable[ArrayLike], space: JointSpace) -> NDArray[np.float64]:
    rows = np.array(list(samples), dtype=np.float64)
    rows = rows if rows.size else np.empty((0, space.dim))
    if rows.ndim != 2 or rows.shape[1] != space.dim:
        expected = f"values of shape (n, {space.dim})"
        raise PlanningError("the samples do not fit the state space", expected=expected, got=str(rows.shape))
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


IsFree = Callable[[NDArray[np.float64]], bool]
"""Whether a configuration, (d,) rad, touches nothing."""


@dataclass(frozen=True, slots=True, eq=False)
class Problem:
    """A planning problem, (d,) rad each, in a scene that a picture shows; only ``is_free`` decides."""

    picture: Picture
    start: ArrayLike
    goal: ArrayLike
    is_free: IsFree


@dataclass(frozen=True, slots=True, eq=False)
class Solution:
    """What a search found: a path, (k, d) rad, or None; and how often it drew and checked what."""

    path: NDArray[np.float64] | None
    learned_drawn: int
    uniform_drawn: int
    goal_drawn: int
    state_checks: int
    solve_time_s: float


class LearnedSampler:
    """A problem with its samples, ready to be solved as often as you like."""

    def __init__(self, problem: Problem, batch: SampleBatch) -> None:
        self.batch, self._is_free = batch, problem.is_free
        self.space: JointSpace = batch.space or circles(batch.samples.shape[1])
        # Limits in single precision may lie a little beyond themselves.
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
        """Searches by RRT and shortens what was found; exceptions of the checker come out.

        Args:
            time_limit_s: of the search, and again of shortening.
            uniform_share: of uniform states among the samples, 0 to 1; after the last sample all are uniform.
            range_rad: longest step of the tree, the sum over the joints.
            resolution_rad: largest distance between checked states in any joint.
            seed: of what is drawn beside the samples. OMPL's own generators keep their state.
        """
        if not all(0.0 < value < math.inf for value in (time_limit_s, range_rad, resolution_rad)):
            got = f"{time_limit_s} s, {range_rad} and {resolution_rad} rad"
            raise ConfigError("a setting of the search is out of range", expected="above 0", got=got)
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
        if values.shape != (self.space.dim,) or not self.space.admits(self.space.clamp(values)):
            raise PlanningError(
                f"the {name} is no configuration of this robot",
                expected=f"{self.space.dim} joints in rad within their limits",
                got=str(values),
                remedy="send angles in rad, and name a model of this robot",
            )
        values = self.space.wrap(self.space.clamp(values))
        if not self._is_free(values.copy()):
            raise PlanningError(f"the {name} is not free", got=str(values))
        return [float(value) for value in values]


def learned_sampler(
    problem: Problem,
    client: SamplingClient,
    *,
    n: int = DEFAULT_SAMPLES,
    seed: int | None = None,
    model: str | None = None,
    with_ends: bool = False,
) -> LearnedSampler:
    """Requests the samples of a problem, all before the search, for OMPL lets nothing else run during it.

    Args:
        problem: to solve.
        client: of the server.
        n: how many samples.
        seed: of the samples; drawn when None.
        model: ``name``, ``name@alias``, ``name/version`` or ``pretrained``.
        with_ends: whether start and goal are sent, as path models require and others refuse.
    """
    ends = {"start": problem.start, "goal": problem.goal} if with_ends else {}
    query = seeded(as_query(SampleQuery, n=n, seed=seed, **ends))
    return LearnedSampler(problem, client.answer(problem.picture, query, model))


class _Checks:
    """The collision checker as OMPL calls it. An error of it ends the search instead of OMPL."""

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
