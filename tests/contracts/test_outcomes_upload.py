"""The upload of outcomes, on the fake and on MLflow: one data set for each batch, whatever is interrupted."""

import json
import shutil
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from cspace.errors import InputError
from cspace.png import encode_png
from cspace.simulator import Split
from cspace.worlds import examples, simulator_of
from cspace_client import OutcomeSender, PlanQuery, SamplingClient
from services import outcomes
from services.evaluator.__main__ import main as evaluator
from services.names import OUTCOMES_FILE
from services.outcomes import Spool, files_of, upload
from tests.contracts.conftest import Backend
from tests.contracts.mlflow_warnings import MLFLOW_WARNINGS
from tests.inference_api.raw import until
from tests.inference_api.server import api_server

pytestmark = MLFLOW_WARNINGS


def plan(number: int, site: str) -> dict[str, Any]:
    return {"kind": "plan", "request_id": f"r{number}", "model": "m/3", "client": "one", "site": site}


def samples(number: int) -> dict[str, Any]:
    return {"kind": "samples", "request_id": f"r{number}", "model": "m/4", "client": None, "checked": 10}


def spooled(folder: Path, *batches: Sequence[dict[str, Any]]) -> Path:
    """A spool with a file for each batch."""
    spool = Spool(folder, 2**28, lambda *_: None)
    for batch in batches:
        assert spool.add(batch)
        spool.flush()
    return folder


def test_each_batch_is_one_data_set_although_its_upload_is_interrupted_before_it_is_deleted(
    backend: Backend, tmp_path: Path, request: pytest.FixtureRequest
) -> None:
    mark = request.node.name
    batches = [plan(1, mark), samples(1)], [plan(1, mark), plan(2, mark)]
    folder = spooled(tmp_path / "spool", *batches)
    going = upload(folder, backend.tracking)
    first = next(going)
    going.close()
    # Meanwhile the server goes on.
    spooled(folder, [plan(3, mark)])
    again, other = upload(folder, backend.tracking)
    assert again == first
    assert (first.counts, other.counts) == ({"plan": 2, "samples": 1}, {"plan": 1})
    record = backend.read(first.run_id)
    assert record.inputs == [("outcomes", first.digest, f"runs:/{first.run_id}/{OUTCOMES_FILE}", "outcomes")]
    assert (record.status, record.params["models"]) == ("FINISHED", '["m/3", "m/4"]')
    path = backend.tracking.file(first.run_id, OUTCOMES_FILE, tmp_path)
    assert path is not None
    rows = [json.loads(line) for line in path.read_text().splitlines()]
    assert rows == [plan(1, mark), samples(1), plan(2, mark)]
    assert list(folder.rglob("*.jsonl")) == []
    assert list(upload(folder, backend.tracking)) == []


def test_a_file_of_something_else_is_named_and_stays(backend: Backend, tmp_path: Path) -> None:
    folder = spooled(tmp_path / "spool", [samples(1)])
    [path] = files_of(folder)
    path.write_text(path.read_text() + '{"kind": "plan"}\n')
    with pytest.raises(InputError, match=path.name):
        list(upload(folder, backend.tracking))
    assert len(list(folder.rglob(path.name))) == 1


def test_the_command_uploads_what_the_setting_names_and_needs_a_folder(
    tmp_path: Path, database_uri: str, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = spooled(tmp_path / "spool", [plan(1, "command"), samples(1)])
    environment = {"MLFLOW_TRACKING_URI": database_uri, "CSPACE_OUTCOMES": str(folder)}
    assert outcomes.main([], environment) == 0
    assert "uploaded 1 of plan, 1 of samples" in capsys.readouterr().out
    assert outcomes.main([], environment) == 0
    assert "uploaded" not in capsys.readouterr().out
    shutil.rmtree(folder)
    assert outcomes.main([], environment) == 2
    assert "CSPACE_OUTCOMES" in capsys.readouterr().err


@pytest.mark.e2e
def test_what_became_of_plans_at_a_site_changes_the_confidence_that_is_stated_there(
    tmp_path: Path, server_uri: str, capsys: pytest.CaptureFixture[str]
) -> None:
    simulator = simulator_of(examples()["two-link"])
    problem = simulator.problem("uniform", Split.VALIDATION, 0, 0)
    picture = encode_png(simulator.render(problem.scenario))
    query = PlanQuery(problem.start.tolist(), problem.goal.tolist(), min_confidence=0.0)
    environment = {"MLFLOW_TRACKING_URI": server_uri, "CSPACE_OUTCOMES": str(tmp_path / "spool")}
    with api_server(tmp_path, environment) as api, SamplingClient(api) as client:
        before = client.plan(picture, query, "pretrained")
        with OutcomeSender(api) as sender:
            for seed in range(24):
                found = client.plan(picture, replace(query, seed=seed), "pretrained")
                # Something stands there that the camera does not see.
                sender.plan(found, success=seed % 3 == 0, collided=seed % 3 != 0, site="cell.4")
        assert sender.sent == 24
        assert evaluator(["recalibrate", "--site", "cell.4"], environment) == 2
        # They are written once a second.
        until(lambda: sum(one.read_bytes().count(b"\n") for one in files_of(tmp_path / "spool")) == 24)
        assert outcomes.main([], environment) == 0
        assert evaluator(["recalibrate", "--site", "cell.4"], environment) == 0
        printed = capsys.readouterr()
        assert "at least 20" in printed.err
        assert "calibration-cell.4/1 of pretrained/0, 24 plans, 66.7% collide" in printed.out
        assert "in use for requests with this site" in printed.out
        assert "import-outcomes $PWD/outcomes --site cell.4" in printed.out
        after = client.plan(picture, replace(query, site="cell.4"), "pretrained")
    assert (before.calibration, after.calibration) == (None, "calibration-cell.4/1")
    assert after.plan.confidence < 0.6 < before.plan.confidence
