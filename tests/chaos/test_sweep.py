"""A sweep that is asked to stop in its middle, as by ``ray job stop``, and then submitted again."""

import signal

import pytest
from mlflow import MlflowClient

from tests.chaos.checks import check_runs
from tests.chaos.system import EVERY, System, settings

pytestmark = [pytest.mark.e2e, pytest.mark.slow, pytest.mark.timeout(600)]

STEPS = {"vae": 50, "validity": 50, "local-0": 400, "local-1": 400, "global": 100}


def test_a_sweep_that_is_stopped_in_its_middle_goes_on_where_it_was(
    tmp_path_factory: pytest.TempPathFactory,
) -> None:
    grid = ("--grid", "seed=[0, 1]", "--at-once", "1", "--scenarios", "2")
    data = tmp_path_factory.mktemp("data")
    with System(tmp_path_factory.mktemp("system"), data) as system:
        stopped = system.run("halves", "sweep.py", settings(STEPS), *grid)
        for _ in stopped.moments():
            # Of the first point's job, and then of the second's.
            if len({path.parents[2] for path in data.glob("jobs/*/local/local-*/step-*")}) == 2:
                break
        stopped.send(signal.SIGTERM)
        assert stopped.wait() == 3, stopped.printed
        assert "submit it again" in stopped.printed
        done = {path: path.stat().st_mtime_ns for path in data.glob("jobs/*/*/*/outcome.json")}
        jobs = {path.name for path in data.glob("jobs/*") if (path / "job.json").is_file()}
        held = list(data.glob("jobs/*/local/local-*/step-*"))

        again = system.run("halves", "sweep.py", settings(STEPS), *grid)
        assert again.wait() == 0, again.printed
        runs = {str(point["run"]) for point in again.result["points"]}
        client = MlflowClient(system.server.address)
        for run_id in runs:
            check_runs(client, run_id, STEPS, EVERY)
    assert again.result["failed"] == 0
    # Both points go on in the runs that they had; what had finished is not trained again.
    assert runs == jobs
    assert len(runs) == 2
    assert len(held) >= 2
    assert len(STEPS) < len(done) < 2 * len(STEPS)
    assert {path: path.stat().st_mtime_ns for path in done} == done
