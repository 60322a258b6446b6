"""Metrics are sent in batches, and what a server missed arrives later, once."""

import time
from types import SimpleNamespace

import pytest
import requests
from mlflow import MlflowClient

from cspace.errors import RegistryUnavailableError
from services.names import NOTE
from services.registry import errors
from services.registry.tracking import MAX_BATCH, VIEW, VIEWS, RunLog, Tracking
from tests.contracts.mlflow_warnings import MLFLOW_WARNINGS

pytestmark = MLFLOW_WARNINGS


class Line:
    """A server on a database, which can be cut off and reached again."""

    def __init__(self, folder, patch):
        self.away, self.sent = False, []
        self.uri = f"sqlite:///{folder / 'mlflow.db'}"
        for name in ("get_run", "log_batch", "set_terminated"):
            patch.setattr(MlflowClient, name, self._cut(name, getattr(MlflowClient, name)))

    def _cut(self, name, call):
        def refuse(*args, **kwargs):
            if self.away:
                raise requests.ConnectionError("cut off")
            if name == "log_batch":
                self.sent.append(len(kwargs.get("metrics", ())))
            return call(*args, **kwargs)

        return refuse

    def history(self, run_id):
        points = MlflowClient(self.uri).get_metric_history(run_id, "loss")
        return sorted((point.step, point.value) for point in points)

    def status(self, run_id):
        return str(MlflowClient(self.uri).get_run(run_id).info.status)


@pytest.fixture
def line(folder, monkeypatch):
    return Line(folder, monkeypatch)


def rows(*steps):
    return [{"step": float(step), "time_ms": 1000.0 * step, "loss": step / 7} for step in steps]


def test_a_trial_that_goes_on_in_an_outage_is_whole_when_its_history_is_sent_again(line):
    run = Tracking(line.uri).start("outage", "trial")
    run.history(rows(1, 2))
    line.away = True
    with pytest.raises(RegistryUnavailableError):
        run.history(rows(3))
    # Another process goes on from the checkpoint; it is made although the server is away.
    again = RunLog(Tracking(line.uri), run.run_id)
    with pytest.raises(RegistryUnavailableError):
        again.history(rows(1, 2, 3, 4))
    line.away = False
    again.history(rows(1, 2, 3, 4, 5))
    again.finish()
    assert line.history(run.run_id) == [(step, step / 7) for step in range(1, 6)]
    assert line.status(run.run_id) == "FINISHED"


def test_what_the_server_took_without_an_answer_is_not_there_twice(line):
    run, real = Tracking(line.uri).start("outage", "half"), MlflowClient.log_batch

    def taken_but_not_answered(*args, **kwargs):
        real(*args, **kwargs)
        raise requests.ConnectionError("reset")

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(MlflowClient, "log_batch", taken_but_not_answered)
        with pytest.raises(RegistryUnavailableError):
            run.metrics({"loss": 1.0}, 1)
    run.metrics({"loss": 2.0}, 2)
    run.finish()
    assert line.history(run.run_id) == [(1, 1.0), (2, 2.0)]


def test_metrics_go_in_batches_that_the_server_takes(line):
    run = Tracking(line.uri).start("batches", "large")
    line.sent.clear()
    run.history([{"step": step, "time_ms": 1.0, "loss": step} for step in range(MAX_BATCH + 5)])
    assert line.sent == [MAX_BATCH, 5]


def test_calls_of_a_tracking_that_waits_wait_for_a_bounded_time(line, monkeypatch):
    def sleep(_: float) -> None:
        line.away = False

    monkeypatch.setattr(errors, "time", SimpleNamespace(monotonic=time.monotonic, sleep=sleep))
    run = Tracking(line.uri, wait_s=600.0).start("outage", "patient")
    line.away = True
    run.history(rows(1))
    assert line.history(run.run_id) == [(1, 1 / 7)]
    line.away = True
    with pytest.raises(RegistryUnavailableError, match=r"stayed away.*submit the job again"):
        Tracking(line.uri, wait_s=0.0).run(run.run_id)


def test_the_searches_are_ones_that_mlflow_understands(line):
    tracking, client, made = Tracking(line.uri), MlflowClient(line.uri), {}
    for stage in ("cluster-train", "local", "evaluation", "planning-benchmark", "other"):
        with tracking.start("views", stage, tags={"stage": stage}) as run:
            made[run.run_id] = stage
    ids = [client.get_experiment_by_name("views").experiment_id]
    found = {
        name: [made[run.info.run_id] for run in client.search_runs(ids, search)]
        for name, (_, search, _) in VIEWS.items()
    }
    assert found == {
        "jobs": ["cluster-train"],
        "trials": ["local"],
        "evaluations": ["evaluation"],
        "planning": ["planning-benchmark"],
    }
    # What somebody wrote onto a page stays.
    client.create_experiment("own", tags={NOTE: "ours"})
    tracking.start("own", "run").finish()
    tags = client.get_experiment_by_name("own").tags
    assert tags[NOTE] == "ours"
    assert f"{VIEW}jobs" in tags
