"""Samples for set-ups that this project did not make."""

import numpy as np
import pytest
from ompl import base as ob
from ompl import geometric as og
from ompl import util as ou

from cspace_client.errors import PlanningError
from cspace_client.ompl import feed_samples, read_configuration, read_joint_space


def circle():
    return ob.SO2StateSpace()


def box(dim, low=-2.0, high=2.0):
    space = ob.RealVectorStateSpace(dim)
    space.setBounds(low, high)
    return space


def product(*parts):
    space = ob.CompoundStateSpace()
    for part in parts:
        space.addSubspace(part, 1.0)
    return space


SPACES = {
    "circle": circle,
    "box": lambda: box(2),
    "torus": lambda: product(circle(), circle()),
    "mixed": lambda: product(box(2), circle()),
}


def make_setup(space, planner=og.RRT, free=lambda values: True, threshold=None, ends=(-1.0, 1.0)):
    """From all joints at one value to all joints at another one."""
    ou.setLogLevel(ou.LOG_NONE)
    setup = og.SimpleSetup(space)
    states, information = setup.getStateSpace(), setup.getSpaceInformation()
    setup.setStateValidityChecker(lambda state: free(read_configuration(states, state)))
    information.setup()
    start, goal = information.allocState(), information.allocState()
    for state, end in ((start, ends[0]), (goal, ends[1])):
        states.copyFromReals(state, [end] * states.getDimension())
    setup.setStartAndGoalStates(start, goal, *(() if threshold is None else (threshold,)))
    if planner is not None:
        setup.setPlanner(planner(information))
    return setup


def rows_of(setup, states):
    return np.array([read_configuration(setup.getStateSpace(), state) for state in states])


def tree_of(setup):
    data = ob.PlannerData(setup.getSpaceInformation())
    setup.getPlannerData(data)
    return rows_of(setup, [data.getVertex(index).getState() for index in range(data.numVertices())])


def counted(count):
    """Ends a search after so many iterations."""
    left = iter(range(count))
    return ob.PlannerTerminationCondition(lambda: next(left, None) is None)


def test_the_planner_draws_these_samples_and_no_others():
    setup = make_setup(SPACES["mixed"](), free=lambda values: values[0] < 0.5)  # the goal is not free
    setup.getPlanner().setGoalBias(0.0)
    setup.getPlanner().setRange(10.0)
    samples = np.random.default_rng(0).uniform(0.0, 0.4, (60, 3)) - [1.0, 0.0, -2.0]
    with feed_samples(setup, samples, uniform_share=0.0) as draws:
        setup.getPlanner().setProblemDefinition(setup.getProblemDefinition())
        setup.getPlanner().setup()
        setup.getPlanner().solve(counted(50))
    assert (draws.learned_drawn, draws.uniform_drawn, draws.goal_drawn) == (50, 0, 0)
    tree = {tuple(row) for row in tree_of(setup).round(9)}
    assert tree == {(-1.0, -1.0, -1.0), *map(tuple, samples[:50].round(9))}


@pytest.mark.parametrize(("kind", "planner"), [*((kind, og.RRT) for kind in SPACES), ("mixed", og.RRTstar)])
def test_a_path_leads_to_the_real_goal(kind, planner):
    setup = make_setup(SPACES[kind](), planner)
    space = read_joint_space(setup.getStateSpace())
    samples = space.sample_uniform(np.random.default_rng(1), 200)
    with feed_samples(setup, samples, uniform_share=0.0) as draws:
        setup.solve(0.2)
    assert setup.haveExactSolutionPath()
    assert draws.goal_drawn > 0
    path = rows_of(setup, setup.getSolutionPath().getStates())
    np.testing.assert_allclose(path[[0, -1]], [[-1.0] * space.dim, [1.0] * space.dim])


def test_the_set_up_is_what_it_was_whatever_ends_the_block():
    setup = make_setup(SPACES["torus"]())
    setup.getPlanner().setGoalBias(0.2)
    goal = setup.getGoal()
    block = feed_samples(setup, np.zeros((1, 2)))
    block.__enter__()
    assert setup.getGoal() is not goal
    assert setup.getPlanner().getGoalBias() == 1.0
    assert not block.__exit__(KeyError, KeyError("of the block"), None)
    assert setup.getGoal() is goal
    assert setup.getPlanner().getGoalBias() == 0.2


def test_the_goals_threshold_holds_in_the_metric_of_the_state_space():
    # 0.8 in each of four joints: 1.6 in OMPL's metric of a box, 3.2 in the sum over the joints.
    setup = make_setup(box(4), threshold=1.7)
    setup.getPlanner().setGoalBias(0.0)
    setup.getPlanner().setRange(10.0)
    with feed_samples(setup, np.full((1, 4), 0.2), uniform_share=0.0) as draws:
        setup.solve(5.0)
    assert setup.haveExactSolutionPath()
    assert (draws.learned_drawn, draws.uniform_drawn) == (1, 0)


def test_other_state_spaces_and_a_goal_of_several_states_are_refused():
    with pytest.raises(PlanningError, match="SO2"):
        read_joint_space(product(ob.SE2StateSpace()))
    setup = make_setup(box(2))
    setup.setGoal(ob.GoalStates(setup.getSpaceInformation()))
    with pytest.raises(PlanningError, match="no single state"), feed_samples(setup, []):
        pass
