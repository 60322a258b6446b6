"""What only shows over whole processes: the same result anywhere, a quiet exit, and flat memory."""

import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import psutil
import pytest

from services.planner.ompl_planner import PlannerSettings, solve

ROOT = Path(__file__).parents[3]
PROGRAM = """
import numpy as np
from cspace.problem import Family, Problem
from cspace.robot import TWO_LINK
from cspace.scenario import Disc, Scenario
from services.planner.ompl_planner import PlannerSettings, solve

scenario = Scenario(TWO_LINK, (Disc(0.0, 3.0),))
problem = Problem(scenario, np.array([0.0, 0.0]), np.array([-3.0, 0.0]), Family.UNIFORM, 0.1, 0, 0)
samples = np.random.default_rng(0).uniform(-np.pi, np.pi, (100, 2))
for planner in ("RRT", "RRTstar"):
    for batch in (None, samples):
        result = solve(problem, PlannerSettings(planner, seed=5), batch)
        print(result.iterations, result.edge_checks, result.learned_drawn, result.path.tobytes().hex())
"""


def run_program():
    return subprocess.run(
        [sys.executable, "-c", PROGRAM],
        capture_output=True,
        text=True,
        check=True,
        env=os.environ | {"PYTHONPATH": str(ROOT)},
    )


def test_the_same_seed_gives_the_same_results_in_any_process(blocked):
    samples = np.random.default_rng(0).uniform(-np.pi, np.pi, (100, 2))
    lines = []
    solve(blocked, PlannerSettings(seed=99))
    for planner in ("RRT", "RRTstar"):
        for batch in (None, samples):
            result = solve(blocked, PlannerSettings(planner, seed=5), batch)
            counts = (result.iterations, result.edge_checks, result.learned_drawn)
            lines.append(" ".join([*map(str, counts), result.path.tobytes().hex()]))
    first, second = run_program(), run_program()
    assert first.stdout.splitlines() == second.stdout.splitlines() == lines
    assert first.stderr == ""


def test_different_seeds_give_different_results(blocked):
    runs = {solve(blocked, PlannerSettings(seed=seed)).path.tobytes() for seed in (0, 1, 2, 2**64 - 1)}
    assert len(runs) == 4


@pytest.mark.slow
@pytest.mark.timeout(300)
def test_two_thousand_solves_leave_the_memory_flat(blocked):
    samples = np.random.default_rng(0).uniform(-np.pi, np.pi, (300, 2))
    memory = psutil.Process().memory_info

    def solve_many(count):
        for seed in range(count):
            solve(blocked, PlannerSettings(seed=seed), samples, keep_tree=True)

    solve_many(200)
    before = memory().rss
    solve_many(2000)
    assert memory().rss - before < 4_000_000
