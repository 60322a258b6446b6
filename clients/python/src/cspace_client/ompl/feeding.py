"""Learned samples for a planner that somebody else has set up, with a state space and a checker of his own.

They enter through the goal, as in ``goal_region``, for as long as a ``with`` block lasts. Afterwards the
set-up has its own goal back: OMPL's ``simplifySolution`` asks the goal for states as well, to end the path at
a better one, and would end it at a learned sample.
"""

from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from ompl import base as ob
from ompl import geometric as og

from cspace_client.errors import ConfigError, PlanningError
from cspace_client.joint_space import JointSpace
from cspace_client.ompl.goal_region import REACHED_RAD, DrawnGoal
from cspace_client.ompl.sample_mixture import SampleMixture, StateDraws
from cspace_client.ompl.state_space import read_configuration, read_joint_space

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
