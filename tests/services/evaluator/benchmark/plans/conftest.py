"""Runs of plans that were never made."""

import pytest

from cspace.worlds.unseen import Taken
from services.evaluator.benchmark.plans.setting import PlanRun, Table

EMPTY = dict.fromkeys(
    (
        "confidence", "clearance_m", "meshes_free", "unseen", "length_rad", "as_is", "state_checks",
        "edge_checks", "iterations", "solve_s", "state_check_s", "mesh_check_s",
    )
)  # fmt: skip


@pytest.fixture
def make_plan():
    """A way without exact checks; without a clearance there is none."""

    def make(arm: str, problem: int, clearance_m: float | None, **values) -> PlanRun:
        told = {
            "table": Table.UNCHECKED.value, "source": "sets", "family": "box", "pictures": 1, "run": 0,
            "sampler": "model" if arm == "model" else None, "search_s": 0.1, "score_s": 0.0, "request_s": 0.2,
            "status": "solved" if clearance_m is not None else "refused",
        }  # fmt: skip
        if arm == Taken.KNOWN:
            told["pictures"] = 0
        found = {**EMPTY, **told, **values}
        solved = clearance_m is not None
        return PlanRun(arm=arm, problem=problem, solved=solved, **{**found, "clearance_m": clearance_m})

    return make


@pytest.fixture
def make_search():
    """A search with exact checks."""

    def make(arm: str, problem: int, states: int, *, solved: bool = True, **values) -> PlanRun:
        told = {
            "table": Table.CHECKED.value, "source": "sets", "family": "box", "run": 0, "search_s": 0.0,
            "pictures": 1 if "model" in arm else 0, "sampler": "model" if "model" in arm else None,
            "score_s": 0.0, "request_s": 0.0, "status": "solved" if solved else "the time limit was reached",
            "state_checks": states, "edge_checks": states // 10, "iterations": states // 20, "as_is": False,
            "solve_s": 2e-6 * states, "state_check_s": 1e-6, "length_rad": 4.0 if solved else None,
        }  # fmt: skip
        return PlanRun(arm=arm, problem=problem, solved=solved, **{**EMPTY, **told, **values})

    return make
