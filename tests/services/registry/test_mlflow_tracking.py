"""Metrics are sent in batches, and those of an outage arrive later: all, once, and in their own run."""

from collections.abc import Iterator
from pathlib import Path

import pytest
import requests
from mlflow import MlflowClient

from cspace.errors import RegistryError, RegistryUnavailableError
from services.names import NOTE
from services.registry import mlflow_errors
from services.registry.tracking import (
    MAX_BATCH,
    VIEW,
    VIEWS,
    Spool,
    Tracking,
    points_of,
    spooled_runs,
)
from tests.contracts.mlflow_warnings import MLFLOW_WARNINGS

pytestmark = MLFLOW_WARNINGS

EXPERIMENT = "spooled"


class Line:
    """A server on a database, which can be cut off and reached again."""

    def __init__(self, folder: Path, patch: pytest.MonkeyPatch) -> None:
        self.away, self.now_s, self.refused = False, 0.0, 0
        self.uri, self.spool = f"sqlite:///{folder / 'mlflow.db'}", folder / "spool"
        for name in ("get_run", "log_batch", "set_terminated", "get_metric_history", "search_runs"):
            patch.setattr(MlflowClient, name, self._cut(getattr(MlflowClient, name)))

    def _cut(self, call):
        def refuse(*args, **kwargs):
            if self.away:
                self.refused += 1
                raise requests.ConnectionError("cut off")
            return call(*args, **kwargs)

        return refuse

    def tracking(self, *, buffer_size: int = 1, **options: float) -> Tracking:
        clock = lambda: self.now_s  # noqa: E731 - of this line
        return Tracking(self.uri, spool_folder=self.spool, clock=clock, buffer_size=buffer_size, **options)

    def history(self, run_id: str, name: str = "loss") -> list[tuple[int, float]]:
        points = MlflowClient(self.uri).get_metric_history(run_id, name)
        return sorted((point.step, point.value) for point in points)

    def status(self, run_id: str) -> str:
        return str(MlflowClient(self.uri).get_run(run_id).info.status)

    def waits(self) -> bool:
        return bool(spooled_runs(self.spool))


@pytest.fixture
def line(folder, monkeypatch) -> Iterator[Line]:
    line = Line(folder, monkeypatch)
    yield line
    line.away = False
    line.tracking().deliver()


def log(run, steps):
    for step in steps:
        run.metrics({"loss": 10.0 * step}, step)


def test_metrics_of_an_outage_arrive_with_the_next_ones_and_no_step_asks_in_vain(line):
    run = line.tracking().start(EXPERIMENT, "outage")
    log(run, [1, 2])
    line.away, line.refused = True, 0
    log(run, [3, 4, 5])
    assert line.refused == 1
    line.now_s = 60.0
    log(run, [6])
    assert line.refused == 2
    assert line.waits()
    line.away, line.now_s = False, 120.0
    log(run, [7])
    run.finish()
    assert line.history(run.run_id) == [(step, 10.0 * step) for step in range(1, 8)]
    assert line.status(run.run_id) == "FINISHED"
    assert not line.waits()


def test_an_outage_that_outlasts_the_process_is_delivered_by_the_next(line):
    run = line.tracking().start(EXPERIMENT, "killed")
    log(run, [1, 2])
    line.away = True
    log(run, [3, 4, 5])
    # The process is killed; its successor starts from a checkpoint of step 3 while the server is still away.
    again = line.tracking().resume(run.run_id)
    log(again, [4, 5, 6])
    again.finish()
    # Whoever delivers is told that the server is away.
    with pytest.raises(RegistryUnavailableError):
        line.tracking().deliver()
    assert line.waits()
    line.away = False
    line.tracking().deliver()
    assert line.history(run.run_id) == [(step, 10.0 * step) for step in range(1, 7)]
    assert line.status(run.run_id) == "FINISHED"
    assert not line.waits()


def test_what_the_server_took_before_the_line_was_cut_is_not_there_twice(line):
    run = line.tracking().start(EXPERIMENT, "half")
    log(run, [1])
    real = MlflowClient.log_batch

    def taken_but_not_answered(*args, **kwargs):
        real(*args, **kwargs)
        raise requests.ConnectionError("reset")

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(MlflowClient, "log_batch", taken_but_not_answered)
        log(run, [2])
    assert line.waits()
    line.now_s = 60.0
    log(run, [3])
    assert line.history(run.run_id) == [(1, 10.0), (2, 20.0), (3, 30.0)]


def test_a_run_that_ended_in_an_outage_and_goes_on_ends_once_more(line):
    run = line.tracking().start(EXPERIMENT, "ended")
    line.away = True
    log(run, [1])
    run.finish("FAILED")
    line.away = False
    again = line.tracking().resume(run.run_id)
    log(again, [2])
    assert line.status(run.run_id) == "RUNNING"
    again.finish()
    assert line.history(run.run_id) == [(1, 10.0), (2, 20.0)]
    assert line.status(run.run_id) == "FINISHED"


def test_a_run_that_ended_in_an_outage_and_went_on_in_it_runs_when_it_is_delivered(line):
    run = line.tracking().start(EXPERIMENT, "ended and gone on")
    line.away = True
    log(run, [1])
    run.finish("FAILED")
    log(line.tracking().resume(run.run_id), [2])
    # The process that went on is killed here; another one delivers.
    line.away = False
    line.tracking().deliver()
    assert line.history(run.run_id) == [(1, 10.0), (2, 20.0)]
    assert line.status(run.run_id) == "RUNNING"


def test_a_line_without_its_end_is_dropped_and_swallows_nothing(line):
    run = line.tracking().start(EXPERIMENT, "torn")
    line.away = True
    log(run, [1])
    with (line.spool / f"{run.run_id}.jsonl").open("a") as file:
        file.write('["loss", 20.0, 17')
    log(run, [3])
    run.finish()
    line.away = False
    line.tracking().deliver()
    assert line.history(run.run_id) == [(1, 10.0), (3, 30.0)]
    assert line.status(run.run_id) == "FINISHED"


def test_a_run_id_can_not_lead_out_of_the_folder(tmp_path):
    Spool(tmp_path / "spool", "../../elsewhere").add(points_of({"loss": 1.0}, 1))
    assert spooled_runs(tmp_path / "spool") == ("elsewhere",)


def test_metrics_wait_for_others_until_there_are_enough_or_the_first_is_old(line):
    run = line.tracking(buffer_size=3, buffer_age_s=10.0).start(EXPERIMENT, "batches")
    log(run, [1, 2])
    assert line.history(run.run_id) == []
    log(run, [3])
    assert len(line.history(run.run_id)) == 3
    line.now_s = 100.0
    log(run, [4])
    line.now_s = 109.0
    log(run, [5])
    assert len(line.history(run.run_id)) == 3
    line.now_s = 110.0
    log(run, [6])
    assert len(line.history(run.run_id)) == 6


def test_no_batch_is_larger_than_the_server_takes(line, monkeypatch):
    sent, log_batch = [], MlflowClient.log_batch

    def counted(*args, metrics=(), **kwargs):
        sent.append(len(metrics))
        log_batch(*args, metrics=metrics, **kwargs)

    run = line.tracking(buffer_size=10_000).start(EXPERIMENT, "large")
    monkeypatch.setattr(MlflowClient, "log_batch", counted)
    log(run, range(MAX_BATCH + 5))
    run.finish()
    assert sent == [MAX_BATCH, 5]
    assert len(line.history(run.run_id)) == MAX_BATCH + 5


def test_without_a_spool_metrics_that_could_not_be_sent_are_sent_with_the_next(line):
    run = Tracking(line.uri, buffer_size=1).start(EXPERIMENT, "kept")
    line.away = True
    with pytest.raises(RegistryUnavailableError):
        log(run, [1])
    line.away = False
    log(run, [2])
    assert line.history(run.run_id) == [(1, 10.0), (2, 20.0)]


class Time:
    """A clock that sleeping moves; the server comes back at a moment of it."""

    def __init__(self, back_s: float, error: RegistryError | None = None):
        self.now_s, self.back_s, self.error = 0.0, back_s, error or RegistryUnavailableError("away")

    def sleep(self, seconds):
        self.now_s += seconds

    def monotonic(self):
        return self.now_s

    def ask(self):
        if self.now_s < self.back_s:
            raise self.error
        return "answer"


def ask_patiently(time, patience_s, monkeypatch):
    monkeypatch.setattr(mlflow_errors, "time", time)
    return mlflow_errors.patiently("asking", time.ask, patience_s)


def test_a_driver_waits_for_a_server_that_comes_back_and_for_nothing_else(monkeypatch):
    time = Time(back_s=20.0)
    assert ask_patiently(time, 600.0, monkeypatch) == "answer"
    assert time.now_s == 20.0
    with pytest.raises(RegistryUnavailableError, match=r"asking: .* 30 s; .*submit the job again"):
        ask_patiently(Time(back_s=1000.0), 30.0, monkeypatch)
    refusal = Time(1000.0, RegistryError("no"))
    with pytest.raises(RegistryError, match="no"):
        ask_patiently(refusal, 600.0, monkeypatch)
    assert refusal.now_s == 0.0


def test_calls_of_a_patient_tracking_wait_and_metrics_do_not(line, monkeypatch):
    time = Time(0.0)
    monkeypatch.setattr(mlflow_errors, "time", time)
    monkeypatch.setattr(time, "sleep", lambda _: setattr(line, "away", False))
    run = line.tracking(wait_s=600.0).start(EXPERIMENT, "patient")
    line.away = True
    log(run, [1])
    assert line.away
    run.tags({"world": "planar"})
    run.finish()
    assert MlflowClient(line.uri).get_run(run.run_id).data.tags["world"] == "planar"


def test_the_searches_are_ones_that_mlflow_understands(line):
    tracking, client, made = Tracking(line.uri), MlflowClient(line.uri), {}
    for stage in ("cluster-train", "local", "evaluation", "planning-benchmark", "other"):
        with tracking.start("views", stage, tags={"stage": stage}) as run:
            made[run.run_id] = stage
    ids = [client.get_experiment_by_name("views").experiment_id]
    found = {
        name: [made[run.info.run_id] for run in client.search_runs(ids, view.search)]
        for name, view in VIEWS.items()
    }
    assert found == {
        "jobs": ["cluster-train"],
        "trials": ["local"],
        "evaluations": ["evaluation"],
        "planning": ["planning-benchmark"],
    }


def test_what_somebody_wrote_onto_the_page_stays(line):
    MlflowClient(line.uri).create_experiment("own", tags={NOTE: "ours"})
    Tracking(line.uri).start("own", "run").finish()
    tags = MlflowClient(line.uri).get_experiment_by_name("own").tags
    assert tags[NOTE] == "ours"
    assert f"{VIEW}jobs" in tags
