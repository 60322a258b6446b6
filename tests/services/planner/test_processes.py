"""The same seed gives the same result in any process."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

from services.planner.ompl_planner import solve
from services.planner.result import LEARNED_PLANNERS, PLANNERS, PlannerSettings

ROOT = Path(__file__).parents[3]
SETTING = """
import numpy as np
from cspace.simulator import Problem
from cspace.worlds.planar.problems import Family
from cspace.worlds.planar.arm import TWO_LINK
from cspace.worlds.planar.world import Disc, Scenario
from services.planner.ompl_planner import solve
from services.planner.result import PlannerSettings
from services.planner.result import LEARNED_PLANNERS, PLANNERS

scenario = Scenario(TWO_LINK, (Disc(0.0, 3.0),))
problem = Problem(scenario, np.array([0.0, 0.0]), np.array([3.0, 0.0]), Family.UNIFORM, 0.1, 0, 0)
"""
OUTCOMES = (
    SETTING
    + """
samples = np.random.default_rng(0).uniform(-np.pi, np.pi, (100, 2))
for planner in PLANNERS:
    for batch in (None, samples) if planner in LEARNED_PLANNERS else (None,):
        for stop in (True, False):
            settings = PlannerSettings(planner, seed=5, max_iterations=400, stop_at_first=stop)
            result = solve(problem, settings, batch)
            counts = (result.iterations, result.edge_checks, result.state_checks, result.learned_drawn)
            print(planner, counts, result.path.tobytes().hex())
"""
)


def run_program(program, *arguments):
    done = subprocess.run(
        [sys.executable, "-c", program, *arguments],
        capture_output=True,
        text=True,
        check=True,
        env=os.environ | {"PYTHONPATH": str(ROOT)},
    )
    assert done.stderr == ""
    return done.stdout.splitlines()


@pytest.mark.slow
def test_the_same_seed_gives_the_same_results_in_any_process_and_after_any_search(blocked, capsys):
    first, second = run_program(OUTCOMES), run_program(OUTCOMES)
    assert first == second
    # Every planner, with and without samples, and with and without a stop at the first solution.
    assert len(first) == 2 * (len(PLANNERS) + len(LEARNED_PLANNERS))
    solve(blocked, PlannerSettings(seed=99))
    exec(OUTCOMES, {})  # noqa: S102 - the same program in this process
    assert capsys.readouterr().out.splitlines() == first
