"""A driver waits for a tracking server that is away, and for nothing else."""

import pytest

from cspace.errors import RegistryError, RegistryUnavailableError
from tests.fakes.registry import FakeTracking
from training.jobs.patience import PatientRun, patiently


class Time:
    """A clock that sleeping moves."""

    def __init__(self):
        self.now_s = 0.0

    def sleep(self, seconds):
        self.now_s += seconds

    def clock(self):
        return self.now_s


def server(failures, error=None):
    """What fails so often and answers then."""
    left = [error or RegistryUnavailableError("away")] * failures

    def call():
        if left:
            raise left.pop()
        return "answer"

    return call


def test_a_server_that_comes_back_is_waited_for():
    time = Time()
    assert patiently("asking", server(4), 600.0, time.sleep, time.clock) == "answer"
    assert time.now_s == 20.0


def test_a_server_that_stays_away_is_an_error_that_says_how_to_go_on():
    time = Time()
    with pytest.raises(RegistryUnavailableError, match=r"asking: .* 30 s; .*submit the job again"):
        patiently("asking", server(1000), 30.0, time.sleep, time.clock)


def test_a_refusal_is_no_absence():
    time = Time()
    with pytest.raises(RegistryError, match="no"):
        patiently("asking", server(1, RegistryError("no")), 600.0, time.sleep, time.clock)
    assert time.now_s == 0.0


def test_a_patient_run_hands_everything_on(tmp_path):
    tracking = FakeTracking()
    (tmp_path / "a.md").write_text("a")
    with PatientRun(tracking.start("experiment", "run"), 0.0) as run:
        run.params({"seed": 1})
        run.tags({"preset": "smoke"})
        run.metrics({"loss": 1.0}, 3)
        run.artifact(tmp_path / "a.md", "report")
        run.dataset("own", "0" * 64, "data/own", "training")
        run.flush()
    record = tracking.runs[run.run_id]
    assert (record.params, record.tags, record.history) == (
        {"seed": "1"},
        {"preset": "smoke"},
        {"loss": [(3, 1.0)]},
    )
    assert set(record.artifacts) == {"report/a.md"}
    assert record.inputs[0]["name"] == "own"
    assert record.status == "FINISHED"
