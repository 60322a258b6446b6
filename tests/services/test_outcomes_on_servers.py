"""From the answer of a plan over its report to a version that the gate promotes, by running services."""

import base64
import os
import sqlite3
import subprocess
import sys
from contextlib import closing

import httpx
import pytest

from cspace.files import encode_png
from cspace.simulator import Split
from cspace.worlds import examples, simulator_of
from services import outcomes
from services.evaluator.__main__ import main as evaluator
from services.outcomes import Spool
from services.registry.__main__ import main as registry
from services.registry.models import ModelRegistry
from tests.contracts.mlflow_server import mlflow_server
from tests.contracts.mlflow_warnings import MLFLOW_WARNINGS
from tests.inference_api.server import api_server

pytestmark = [*MLFLOW_WARNINGS, pytest.mark.e2e, pytest.mark.slow, pytest.mark.timeout(500)]
NAME = "cspace-sampler"


def test_reports_with_receipts_make_a_version_that_the_gate_promotes(tmp_path, capsys):
    simulator = simulator_of(examples()["two-link"])
    folder = tmp_path / "spool"
    with mlflow_server(tmp_path) as uri:
        environment = {"MLFLOW_TRACKING_URI": uri, "CSPACE_OUTCOMES": str(folder)}
        assert registry(["models", "import", "inference_api/pretrained", NAME], environment) == 0
        assert registry(["models", "promote", f"{NAME}/1", "--reason", "first"], environment) == 0
        settings = {"CSPACE_REGISTRY_URI": uri, **environment}
        with api_server(tmp_path, settings) as api, httpx.Client(base_url=api, timeout=60.0) as client:
            reports = []
            for number in range(28):
                problem = simulator.problem("uniform", Split.VALIDATION, 0, number)
                body = {
                    "image": base64.b64encode(encode_png(simulator.render(problem.scenario))).decode(),
                    "start": problem.start.tolist(),
                    "goal": problem.goal.tolist(),
                    "model": f"{NAME}/1",
                    "min_confidence": 0.0,
                }
                answer = client.post("/plan", json=body)
                if answer.json()["status"] == "solved":
                    # Something stands there that the camera does not see.
                    collided = len(reports) % 3 != 0
                    reports.append(
                        {"kind": "plan", "request_id": answer.headers["X-Request-ID"], "model": f"{NAME}/1"}
                        | {"receipt": answer.json()["receipt"], "success": not collided, "collided": collided}
                    )
            assert len(reports) >= 22
            forged = [{**one, "receipt": "none", "confidence": 0.1, "collided": False} for one in reports]
            assert client.post("/outcomes", json={"outcomes": forged}).status_code == 422
            assert client.post("/outcomes", json={"outcomes": forged + reports}).json() == {
                "kept": len(reports)
            }
        assert outcomes.main([], environment) == 0
        assert evaluator(["recalibrate"], environment) == 2
        assert "1 trusts one client alone" in capsys.readouterr().err
        assert evaluator(["recalibrate", "--most-per-client", "1"], environment) == 0
        quick = ["--model", f"{NAME}@challenger", "--scenarios", "5"]
        assert evaluator(quick, environment) == 0
        assert "log loss of reported plans" in capsys.readouterr().out
        champion = ModelRegistry(uri).by_alias(NAME, "champion")
        assert champion.number == 2


def test_the_command_needs_a_folder_and_leaves_it_while_the_registry_is_away(tmp_path, capsys):
    environment = {"MLFLOW_TRACKING_URI": "http://127.0.0.1:1", "CSPACE_OUTCOMES": str(tmp_path / "none")}
    assert outcomes.main([], environment) == 2
    assert "CSPACE_OUTCOMES" in capsys.readouterr().err
    row = {"kind": "samples", "request_id": "r", "client": None, "model": "m/1", "checked": 9, "free": 9}
    assert Spool(tmp_path / "none", 2**24, lambda *_: None).add([row])
    command = [sys.executable, "-m", "services.outcomes"]
    done = subprocess.run(command, env=os.environ | environment, capture_output=True, check=False)
    assert done.returncode == 1
    with closing(sqlite3.connect(tmp_path / "none" / outcomes.DATABASE)) as database:
        assert database.execute("SELECT COUNT(*) FROM outcomes").fetchone() == (1,)
