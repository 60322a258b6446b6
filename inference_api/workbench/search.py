"""Planners that grow trees among a scene's true discs, for the page to draw; runs in a worker thread.

They are this project's own, compiled where it counts: OMPL's hold the interpreter's lock while they search,
and nobody else would be answered meanwhile. `python -m services.planner` has those.
"""

from dataclasses import dataclass

import numpy as np
from fastapi.responses import Response
from numpy.typing import NDArray

from cspace.planning.paths import NOISE_RAD, AlongPaths, length_rad
from cspace.planning.rrt_connect import GOAL_BIAS, Grown, Growth, drawn_states, grow_connect, grow_rrt
from cspace.simulator import Checker, Split
from cspace.world import World
from cspace.worlds import simulator_of
from inference_api.models.served import ServedModel
from inference_api.turns.searching import searching
from inference_api.turns.turns import Turn
from inference_api.workbench.search_schemas import SearchAnswer, SearchRequest
from inference_api.workbench.truth import among, planar, rows_of, telling, way_truth, wrong_field
from inference_api.workbench.truth_schemas import MAX_SHOWN
from services.registry.references import ModelReference

# As the planner's command has it.
_UNIFORM_SHARE = 0.3


@dataclass(frozen=True, slots=True, eq=False)
class SearchQuestion:
    """A problem and a planner; an :class:`~inference_api.pages.exchange.Question`."""

    asked: SearchRequest
    reference: ModelReference

    def answer(self, served: ServedModel, turn: Turn) -> Response:
        """Search and write.

        Raises:
            CspaceError: as the contract's table of errors.
            ClientDisconnect: the client has gone away.
        """
        asked, world = self.asked, planar(served.bundle.spec.world)
        ends = world.space.bound(
            np.concatenate([rows_of("start", (asked.start,), world), rows_of("goal", (asked.goal,), world)])
        )
        samples = _given(asked, world)
        with searching(turn) as between, telling():
            simulator = simulator_of(among(world, asked.discs))
            checker = simulator.checker(simulator.scene(np.random.default_rng(0), Split.TEST, 0))
            free = checker.valid_batch(ends)
            if not free.all():
                reason = f"the {'goal' if free[0] else 'start'} collides"
                body = SearchAnswer(status="refused", reason=reason)
            else:
                measures = simulator.measures
                growth = Growth(measures.range_rad, measures.resolution_rad, asked.time_limit_s, between)
                body = _searched(asked, checker, ends, samples, growth)
        return Response(body.model_dump_json(), media_type="application/json")


def _given(asked: SearchRequest, world: World) -> NDArray[np.float64] | None:
    """What is drawn before uniform states, (n, d) rad: samples as they are, or states about ways."""
    if not asked.ways:
        return rows_of("samples", asked.samples, world) if asked.samples else None
    if sum(map(len, asked.ways)) > MAX_SHOWN or not all(asked.ways):
        raise wrong_field("ways", asked.EXPECTED["ways"], f"{len(asked.ways)} ways")
    ways = [rows_of("ways", way, world) for way in asked.ways]
    along = AlongPaths(ways, world.space, np.random.default_rng(asked.seed))
    return along.take(min(asked.max_iterations, len(NOISE_RAD) * along.turn_rows))[0]


def _searched(
    asked: SearchRequest,
    checker: Checker,
    ends: NDArray[np.float64],
    samples: NDArray[np.float64] | None,
    growth: Growth,
) -> SearchAnswer:
    # The stream of the planner's command, so that a seed and its samples give the same search there.
    rng = np.random.default_rng(np.random.SeedSequence(asked.seed, spawn_key=(2,)))
    states, learned = drawn_states(checker.space, samples, _UNIFORM_SHARE, asked.max_iterations, rng)
    if asked.planner == "RRT":
        towards_goal = rng.random(len(states)) < GOAL_BIAS
        learned &= ~towards_goal
        found = grow_rrt(checker, ends[0], ends[1], states, towards_goal, growth)
    else:
        found = grow_connect(checker, ends[0], ends[1], states, growth)
    return _told(asked, checker, found, int(learned[: found.iterations].sum()))


def _told(asked: SearchRequest, checker: Checker, found: Grown, learned_drawn: int) -> SearchAnswer:
    body = SearchAnswer(
        status="timeout" if found.timed_out else "exhausted",
        reason=f"no way was found within {asked.max_iterations} iterations",
        iterations=found.iterations,
        edge_checks=found.edge_checks,
        state_checks=found.state_checks,
        learned_drawn=learned_drawn,
        search_ms=1e3 * found.time_s,
        nodes=found.nodes.round(4).tolist(),
        parents=found.parents.tolist(),
    )
    if found.path is not None:
        body.status, body.reason, body.path = "solved", None, found.path.tolist()
        body.length_rad, body.way = length_rad(found.path, checker.space), way_truth(checker, found.path)
    elif found.timed_out:
        body.reason = f"no way was found within {asked.time_limit_s:g} s"
    return body
