"""Trees that grow among a scene's true discs: found ways are free, counts are theirs, and bounds hold."""

from typing import Any

import numpy as np
import pytest

from cspace.simulator import Problem
from cspace.worlds.planar.arm import TWO_LINK
from cspace.worlds.planar.checks import CollisionChecker
from cspace.worlds.planar.world import Disc, Scenario
from services.planner.ompl_planner import solve
from services.planner.settings import SAMPLED_CONNECT, PlannerSettings
from tests.inference_api.answers import assert_problem
from tests.inference_api.client import ApiClient

DISCS = [[2.5, 0.0, 0.5]]
SCENE = Scenario(TWO_LINK, (Disc(2.5, 0.0, 0.5),))
CHECKER = CollisionChecker(SCENE)
START, GOAL = [1.2, 0.0], [-1.2, 0.0]
REQUEST: dict[str, Any] = {"discs": DISCS, "start": START, "goal": GOAL, "planner": "RRTConnect", "seed": "7"}
PLANNERS = ("RRT", "RRTConnect")


def found(api: ApiClient, **fields: Any) -> dict[str, Any]:
    answer = api.post("/workbench/search", json={**REQUEST, **fields})
    assert answer.status_code == 200, answer.text
    body: dict[str, Any] = answer.json()
    return body


@pytest.mark.parametrize("planner", PLANNERS)
def test_a_way_leads_from_start_to_goal_and_is_free_by_an_independent_check(
    bench: ApiClient, planner: str
) -> None:
    answer = found(bench, planner=planner)
    path = np.array(answer["path"])
    assert (answer["status"], answer["reason"]) == ("solved", None)
    np.testing.assert_allclose(path[[0, -1]], [START, GOAL], atol=1e-9)
    assert CHECKER.edge_batch(path[:-1], path[1:], 0.002).all()
    assert answer["path_verdict"]["free"] is True
    assert answer["length_rad"] == pytest.approx(TWO_LINK.space.distance(path[:-1], path[1:]).sum())
    assert answer["state_checks"] > answer["edge_checks"] >= answer["iterations"] > 0
    # Every branch is free and leads to a root.
    nodes, parents = np.array(answer["nodes"]), np.array(answer["parents"])
    children = np.flatnonzero(parents >= 0)
    assert len(nodes) - len(children) == {"RRT": 1, "RRTConnect": 2}[planner]
    assert len(children) > 3
    # Rounded, a branch may graze what it does not touch.
    assert CHECKER.edge_batch(nodes[parents[children]], nodes[children], 0.0314).mean() > 0.95


def test_the_search_is_that_of_the_planners_command(bench: ApiClient) -> None:
    samples = np.random.default_rng(0).uniform(-3.0, 3.0, (40, 2))
    answer = found(bench, samples=samples.tolist(), max_iterations=5000)
    settings = PlannerSettings(planner=SAMPLED_CONNECT, seed=7, max_iterations=5000)
    own = solve(Problem(SCENE, np.array(START), np.array(GOAL)), settings, samples)
    assert answer["iterations"] == own.iterations
    assert answer["learned_drawn"] == own.learned_drawn > 0
    np.testing.assert_allclose(answer["path"], own.path)


@pytest.mark.parametrize("planner", PLANNERS)
def test_states_about_a_way_that_is_free_are_all_that_is_needed(bench: ApiClient, planner: str) -> None:
    way = found(bench)["path"]
    answer = found(bench, planner=planner, paths=[way], seed=3, max_iterations=400)
    assert answer["status"] == "solved"
    assert answer["learned_drawn"] > 0.5 * answer["iterations"]


@pytest.mark.parametrize("planner", PLANNERS)
def test_the_budget_and_the_time_end_a_search_that_finds_nothing(bench: ApiClient, planner: str) -> None:
    answer = found(bench, planner=planner, max_iterations=2)
    assert (answer["status"], answer["iterations"], answer["path"]) == ("exhausted", 2, [])
    assert "within 2 iterations" in answer["reason"]
    # A ring that nothing leads through.
    wall = [[3.4 * np.cos(at), 3.4 * np.sin(at), 0.7] for at in (0.6, -0.6, 2.5)]
    answer = found(bench, planner=planner, discs=wall, max_iterations=20_000, time_limit_s=0.01)
    assert answer["status"] in ("timeout", "solved")
    if answer["status"] == "timeout":
        assert "within 0.01 s" in answer["reason"]


def test_an_end_that_collides_is_named(bench: ApiClient) -> None:
    answer = found(bench, start=[0.0, 0.0])
    assert (answer["status"], answer["reason"], answer["nodes"]) == ("refused", "the start collides", [])
    assert found(bench, goal=[0.0, 0.0])["reason"] == "the goal collides"


WRONG: list[dict[str, Any]] = [
    {"planner": "PRM"},
    {"start": [0.0]},
    {"samples": [[0.0]]},
    {"paths": [[]]},
    {"paths": [[[0.0, 0.0]] * 2000] * 2},
    {"max_iterations": 20_001},
    {"time_limit_s": 11},
    {"seed": -1},
]


def test_what_is_wrong_is_refused(bench: ApiClient) -> None:
    for wrong in WRONG:
        assert_problem(bench.post("/workbench/search", json={**REQUEST, **wrong}), 422, "invalid-value")


def test_angles_beyond_the_limits_are_told_by_their_field(bench: ApiClient) -> None:
    row = [0.0, 1e5]
    for field, value in {"start": row, "goal": row, "samples": [row], "paths": [[row]]}.items():
        answer = bench.post("/workbench/search", json={**REQUEST, field: value})
        assert (answer.status_code, answer.json()["errors"][0]["field"]) == (422, field)
