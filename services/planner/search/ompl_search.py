"""The OMPL objects of one search: made here, read here, and gone with the function that asked for them."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Generic, TypeVar

import numpy as np
from ompl import base as ob
from ompl import geometric as og
from ompl import util as ou

from cspace.simulator import Checker, Problem
from cspace_client.ompl.sample_mixture import SampleMixture, StateDraws
from cspace_client.ompl.state_space import DrawnGoal, StateAccess, make_state_space
from services.planner.plan_result import SearchTree
from services.planner.search.path_objective import make_objective
from services.planner.search.validity import EdgeValidator, StateValidator
from services.planner.settings import BIT_STAR, OPTIMISING_PLANNERS, PRM, RRT_CONNECT, PlannerSettings

Edges = TypeVar("Edges", bound=EdgeValidator)


@dataclass(frozen=True, slots=True)
class OmplSearch(Generic[Edges]):
    """The OMPL objects of one search; none of them outlives it."""

    planner: Any
    definition: Any
    information: Any
    edges: Edges
    states: StateValidator
    access: StateAccess
    draws: StateDraws

    @property
    def state_checks(self) -> int:
        """States that were looked at so far, within motions and alone."""
        return self.edges.states + self.states.checks + self.draws.state_checks


def set_up(
    problem: Problem,
    settings: PlannerSettings,
    draws: StateDraws,
    checker: Checker,
    make_validator: Callable[[Any, Checker, float], Edges],
) -> OmplSearch[Edges]:
    """Everything that a search needs, seeded.

    Args:
        problem: start and goal in a scenario.
        settings: of the planner.
        draws: where the goal takes its states from; a mixture replaces OMPL's uniform sampler altogether.
        checker: of the scenario.
        make_validator: of OMPL's space information, the checker and the resolution.
    """
    # OMPL calls a second seed in a process an error, yet takes it for all generators made from then on.
    ou.setLogLevel(ou.LOG_NONE)
    ou.RNG.setSeed(_ompl_seed(settings.seed))
    space = problem.space
    access = StateAccess(space)
    information = ob.SpaceInformation(make_state_space(space))
    edges = make_validator(information, checker, settings.resolution_rad)
    states = StateValidator(checker)
    information.setStateValidityChecker(states)
    information.setMotionValidator(edges)
    information.setup()
    definition = ob.ProblemDefinition(information)
    start = information.allocState()
    access.write(start, space.wrap(problem.start).tolist())
    definition.addStartState(start)
    mixed = isinstance(draws, SampleMixture)
    goal = space.wrap(problem.goal).tolist()
    definition.setGoal(DrawnGoal(information, space, goal, draws, unlimited=mixed))
    if settings.planner in OPTIMISING_PLANNERS:
        definition.setOptimizationObjective(
            make_objective(information, space, goal, settings.planner, stop_at_first=settings.stop_at_first)
        )
    planner = _make_planner(information, definition, settings, 1.0 if mixed else settings.goal_bias)
    return OmplSearch(planner, definition, information, edges, states, access, draws)


def _make_planner(information: Any, definition: Any, settings: PlannerSettings, goal_bias: float) -> Any:
    planner = getattr(og, settings.planner)(information)
    if settings.planner not in (PRM, BIT_STAR):
        planner.setRange(settings.range_rad)
    if settings.planner not in (PRM, BIT_STAR, RRT_CONNECT):
        planner.setGoalBias(goal_bias)
    planner.setProblemDefinition(definition)
    planner.setup()
    return planner


def _ompl_seed(seed: int) -> int:
    """OMPL takes no zero, and neighbouring seeds should not be neighbours in its generator."""
    return int(np.random.SeedSequence(seed).generate_state(1)[0] % (2**31 - 1)) + 1


def copy_tree(run: OmplSearch[Edges]) -> SearchTree:
    """The planner's tree as arrays that outlive it.

    Not for BIT*, which never gives its memory back once it was asked for its tree (12 kB a search).
    """
    data = ob.PlannerData(run.information)
    run.planner.getPlannerData(data)
    count = data.numVertices()
    vertices = run.access.rows([data.getVertex(index).getState() for index in range(count)])
    edges = [(index, child) for index in range(count) for child in data.getEdges(index)]
    return SearchTree(vertices, np.array(edges, dtype=np.intp).reshape(-1, 2))
