"""What a run logs while its server is away arrives later: everything, once, and in its own run."""

from collections.abc import Iterator
from pathlib import Path

import pytest
import requests
from mlflow import MlflowClient

from cspace.errors import RegistryUnavailableError
from services.registry.tracking.metric_buffer import MetricPoint
from services.registry.tracking.mlflow_tracking import MlflowTracking
from services.registry.tracking.spool import Ending, Spool, spooled_runs
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
        def asked(*args, **kwargs):
            if self.away:
                self.refused += 1
                raise requests.ConnectionError("cut off")
            return call(*args, **kwargs)

        return asked

    def tracking(self) -> MlflowTracking:
        return MlflowTracking(self.uri, spool_folder=self.spool, clock=lambda: self.now_s, buffer_size=1)

    def history(self, run_id: str, name: str = "loss") -> list[tuple[int, float]]:
        points = MlflowClient(self.uri).get_metric_history(run_id, name)
        return sorted((point.step, point.value) for point in points)

    def status(self, run_id: str) -> str:
        return str(MlflowClient(self.uri).get_run(run_id).info.status)

    def waits(self) -> bool:
        return bool(spooled_runs(self.spool))


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    folder = tmp_path_factory.mktemp("database")
    with pytest.MonkeyPatch.context() as patch:
        # The store fixes its folder of artifacts, ./mlruns, when it is opened for the first time.
        patch.chdir(folder)
        MlflowTracking(f"sqlite:///{folder / 'mlflow.db'}").start(EXPERIMENT, "first")
    return folder


@pytest.fixture
def line(folder, monkeypatch) -> Iterator[Line]:
    line = Line(folder, monkeypatch)
    yield line
    line.away = False
    line.tracking().deliver()


def log(run, steps):
    for step in steps:
        run.metrics({"loss": 10.0 * step}, step)


def test_metrics_of_an_outage_arrive_with_the_next_ones(line):
    run = line.tracking().start(EXPERIMENT, "outage")
    log(run, [1, 2])
    line.away = True
    log(run, [3, 4])
    assert line.waits()
    line.away, line.now_s = False, 60.0
    log(run, [5])
    run.finish()
    assert line.history(run.run_id) == [(step, 10.0 * step) for step in (1, 2, 3, 4, 5)]
    assert line.status(run.run_id) == "FINISHED"
    assert not line.waits()


def test_a_server_that_was_away_is_not_asked_at_every_step(line):
    run = line.tracking().start(EXPERIMENT, "patience")
    log(run, [1])
    line.away, line.refused = True, 0
    log(run, [2, 3, 4, 5])
    assert line.refused == 1
    line.now_s = 60.0
    log(run, [6])
    assert line.refused == 2


def test_an_outage_that_outlasts_the_process_is_delivered_by_the_next(line):
    run = line.tracking().start(EXPERIMENT, "killed")
    log(run, [1, 2])
    line.away = True
    log(run, [3, 4, 5])
    # The process is killed; its successor starts from a checkpoint of step 3 while the server is still away.
    again = line.tracking().resume(run.run_id)
    log(again, [4, 5, 6])
    again.finish()
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


def test_whoever_delivers_is_told_that_the_server_is_away(line):
    run = line.tracking().start(EXPERIMENT, "away")
    line.away = True
    log(run, [1])
    with pytest.raises(RegistryUnavailableError):
        line.tracking().deliver()
    assert line.waits()


def test_a_line_without_its_end_is_dropped_and_swallows_nothing(tmp_path):
    spool = Spool(tmp_path, "run")
    spool.add([MetricPoint("loss", 1.0, 1, 5)])
    with (tmp_path / "run.jsonl").open("a") as file:
        file.write('{"name": "loss", "val')
    spool.add([MetricPoint("loss", float("nan"), 2, 6)])
    spool.end(Ending("FINISHED", 7))
    waiting = spool.read()
    assert [(point.step, point.time_ms) for point in waiting.points] == [(1, 5), (2, 6)]
    assert waiting.ending == Ending("FINISHED", 7)


def test_a_run_id_can_not_lead_out_of_the_folder(tmp_path):
    Spool(tmp_path / "spool", "../../elsewhere").add([MetricPoint("loss", 1.0, 1, 5)])
    assert spooled_runs(tmp_path / "spool") == ("elsewhere",)
