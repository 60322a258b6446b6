"""A challenger as the champion's shadow, from requests to the gate's evidence, on a real API and MLflow."""

from dataclasses import replace
from functools import partial
from pathlib import Path

import httpx
import numpy as np
import pytest

from cspace.bundle import Bundle, write_bundle
from cspace.png import encode_png
from cspace.simulator import Split
from cspace.worlds import examples, simulator_of
from cspace_client import OutcomeSender, PlanQuery, SamplingClient
from services import outcomes
from services.evaluator.evaluation.shadow import shadow_evidence
from services.outcomes import files_of
from services.registry import __main__ as models
from services.registry.mlflow_registry import MlflowRegistry
from services.registry.mlflow_tracking import MlflowTracking
from tests.bundles import tiny_graphs, tiny_spec
from tests.contracts.mlflow_warnings import MLFLOW_WARNINGS
from tests.inference_api.raw import until
from tests.inference_api.server import api_server

pytestmark = [pytest.mark.e2e, pytest.mark.timeout(300), *MLFLOW_WARNINGS]
NAME = "two-link-shadowed"
PLANS = 24


def bundle(folder: Path, calibration: tuple[float, float]) -> Bundle:
    spec = replace(tiny_spec(), confidence_threshold=0.45, plan_calibration=(calibration,))
    return Bundle.load(write_bundle(folder, spec, tiny_graphs(spec, validity=True)))


def test_the_gate_hears_how_a_challenger_predicts_what_became_of_real_requests(
    tmp_path: Path, server_uri: str
) -> None:
    registry, tracking = MlflowRegistry(server_uri), MlflowTracking(server_uri)
    run = tracking.start("contract", "made")
    for number, (offset, alias) in enumerate(((0.0, "champion"), (-3.0, "challenger")), 1):
        made = bundle(tmp_path / f"bundle-{number}", (offset, 1.0))
        registry.register(NAME, made.folder, run.run_id, made.digest, {}, alias=alias)
    environment = {"MLFLOW_TRACKING_URI": server_uri, "CSPACE_OUTCOMES": str(tmp_path / "spool")}
    assert models.main(["models", "shadow", f"{NAME}@challenger", "--share", "1"], environment) == 0
    simulator = simulator_of(examples()["two-link"])
    problem = simulator.problem("uniform", Split.VALIDATION, 0, 0)
    picture = encode_png(simulator.render(problem.scenario))
    query = PlanQuery(problem.start.tolist(), problem.goal.tolist(), min_confidence=0.0)
    spool = tmp_path / "spool"
    with api_server(tmp_path, environment) as api, SamplingClient(api) as client:
        with OutcomeSender(api) as sender:
            for seed in range(PLANS):
                found = client.plan(picture, replace(query, seed=seed), NAME)
                sender.plan(found, success=True, collided=False)
                line = f'cspace_shadow_total{{result="compared"}} {seed + 1}.0'
                until(partial(is_exported, api, line))
        assert (found.model.model_name, found.model.model_version) == (NAME, 1)
        until(lambda: sum(one.read_bytes().count(b"\n") for one in files_of(spool)) == 2 * PLANS)
        assert outcomes.main([], environment) == 0
    evidence = shadow_evidence(registry.version(NAME, 2), 1, tracking, np.random.default_rng(0))
    assert evidence is not None
    assert (evidence.plans, evidence.outcomes) == (PLANS, PLANS)
    # All were free, and the challenger is surer of each than the champion.
    assert evidence.gain is not None
    assert evidence.gain.low > 0.0


def is_exported(api: str, line: str) -> bool:
    return line in httpx.get(f"{api}/metrics", timeout=30, trust_env=False).text
