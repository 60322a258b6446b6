"""Runs that were never run, for tests of what is made of them; and the shipped head's path sampler."""

from pathlib import Path

import pytest

from cspace.bundle import Bundle
from cspace.simulator import Split
from inference_api.settings import PRETRAINED_FOLDER
from services.evaluator.benchmark.arms import Protocol, Setting
from services.evaluator.benchmark.runs import frame_of
from services.evaluator.benchmark.summary import Paired
from training.paths.writing import make_path_bundle

EXAMPLE = {
    "protocol": "families", "family": "narrow", "problem": 0, "run": 0, "seed": 1, "arm": "RRT, uniform",
    "group": "uniform", "planner": "RRT", "sampler": None, "learned_share": 0.0, "samples_asked": 0,
    "samples_got": 0, "epsilon_sigma": [0.0], "min_confidence": 0.0, "range_rad": 1.0, "stop_at_first": True,
    "iteration_limit": 1000, "time_limit_s": 10.0, "solved": True, "reason": "solved", "iterations": 100,
    "edge_checks": 100, "state_checks": 2000, "learned_drawn": 0, "uniform_drawn": 95, "solve_s": 0.003,
    "state_check_s": 1e-6, "check_s": 0.002, "plan_s": 0.001, "request_s": 0.0, "decode_s": 0.0,
    "encode_s": 0.0, "generate_s": 0.0, "server_s": 0.0, "transport_s": 0.0, "total_s": 0.003,
    "length_rad": 4.0, "first_iterations": 100, "first_edge_checks": 100, "first_s": 0.003,
    "first_length_rad": 4.0, "cost_iterations": [], "cost_edge_checks": [], "cost_s": [],
    "cost_length_rad": [], "novelty": None, "bottleneck_rad": 0.05,
}  # fmt: skip
LENGTHS = ("length_rad", "first_iterations", "first_edge_checks", "first_s", "first_length_rad")


@pytest.fixture
def make_run():
    """A row like the example but for what is named; one without success has no lengths."""

    def make(**values) -> dict:
        found = EXAMPLE | values
        if not found["solved"]:
            found |= dict.fromkeys(LENGTHS) | {"reason": "the iteration limit was reached"}
        return found

    return make


@pytest.fixture
def paired():
    """Rows of a protocol as runs that are compared."""
    return lambda rows: Paired(frame_of(rows, Protocol.FAMILIES))


@pytest.fixture(scope="session")
def setting() -> Setting:
    return Setting(Protocol.FAMILIES, Split.VALIDATION, 0, 2000, 300, 10.0)


@pytest.fixture(scope="session")
def path_folder(tmp_path_factory) -> Path:
    """The path sampler of the shipped bundle's validity head."""
    folder = tmp_path_factory.mktemp("benchmark") / "path-bundle"
    return make_path_bundle(Bundle.load(PRETRAINED_FOLDER), folder).folder
