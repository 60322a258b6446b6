"""Runs that were never run, for tests of what is made of them; and the shipped head's path sampler."""

from pathlib import Path

import pandas as pd
import pytest

from cspace.bundle import Bundle
from cspace.simulator import Split
from cspace.worlds import examples
from inference_api.settings import PRETRAINED_FOLDER
from services.evaluator.benchmark.job import COLUMNS
from services.evaluator.benchmark.report import Results
from services.evaluator.benchmark.variants import Protocol, Setting, table
from training.path_sampler import make_path_bundle


@pytest.fixture(scope="session")
def setting() -> Setting:
    return Setting(Protocol.FAMILIES, Split.VALIDATION, 0, 2000, 10.0)


@pytest.fixture
def results_of(setting):
    """Rows of runs, given by what matters of them, as the results of a benchmark with the model ``model``."""

    def make(rows, protocol=Protocol.FAMILIES) -> Results:
        variants = table(protocol, ["model"])
        by_name = {one.name: one for one in variants}
        whole = []
        for row in rows:
            variant = by_name[row["variant"]]
            usual = {
                "protocol": protocol, "source": "MotionBenchMaker", "family": "narrow", "problem": 0,
                "run": 0, "pictures": 0, "seed": 1, "group": variant.group.value, "planner": variant.planner,
                "sampler": variant.sampler, "learned_share": variant.share, "samples": 0, "solved": True,
                "status": "solved", "request_s": 0.0, "search_s": 0.0, "score_s": 0.0,
            }  # fmt: skip
            whole.append(dict.fromkeys(COLUMNS) | usual | row)
        runs = pd.DataFrame(whole, columns=list(COLUMNS)).astype(COLUMNS)
        plans = protocol is Protocol.PLANS
        own = Setting(protocol, Split.VALIDATION, 0, 1000, 20.0, world=examples()["panda"])
        return Results(runs, own if plans else setting, variants, (1,) if plans else (0,), {"samplers": {}})

    return make


@pytest.fixture(scope="session")
def path_folder(tmp_path_factory) -> Path:
    """The path sampler of the shipped bundle's validity head."""
    folder = tmp_path_factory.mktemp("benchmark") / "path-bundle"
    return make_path_bundle(Bundle.load(PRETRAINED_FOLDER), folder).folder
