"""Trials as tasks of a real Ray: what is recorded, retried, stopped, and gone on with."""

import logging
import os
import signal
import threading
import time
from pathlib import Path

import pytest

from cspace.errors import JobError
from tests.training.trials.ray_nodes import ray_nodes
from training.config import ResourceConfig
from training.trials.launch import TrialRequest, read_outcome, run_trials, stop_on_sigterm

NAMES = ("one", "two", "three")
# Each death costs a new worker's start.
DIE = pytest.param("die", marks=pytest.mark.slow)


@pytest.fixture(scope="module")
def cluster():
    """Room for two trials at once."""
    with ray_nodes([{"num_cpus": 2}]) as ids:
        yield ids


@pytest.fixture
def trials(tmp_path):
    return [TrialRequest(tmp_path / "job" / "stage" / name, job="a job") for name in NAMES]


def trainable():
    """A trial that notes each attempt, does what is planned for it, and leaves a checkpoint of a step."""

    def train(trial, notes, plans):
        import psutil

        with Path(notes, trial.name).open("a") as file:
            file.write(" ".join(psutil.Process().cmdline()).strip() + "\n")
        attempt = len(Path(notes, trial.name).read_text().splitlines())
        plan = plans.get(trial.name, ())
        if plan == "until stopped":
            while not trial.stop.exists():
                time.sleep(0.05)
            # As a trial that takes a while to write its checkpoint.
            time.sleep(1.0)
            Path(notes, f"{trial.name}-stopped").touch()
            return None
        if attempt <= len(plan) and plan[attempt - 1] == "raise":
            raise ValueError(f"attempt {attempt}")
        if attempt <= len(plan) and plan[attempt - 1] == "die":
            os.kill(os.getpid(), signal.SIGKILL)
        (trial.folder / "step-000000004").mkdir(exist_ok=True)
        return {"a_loss": 0.25, "attempt": attempt}

    return train


def run(trials, folder, plans=None, **resources):
    """The outcomes of trials of these plans."""
    notes = folder / "notes"
    notes.mkdir(exist_ok=True)
    shared = {"notes": str(notes), "plans": plans or {}}
    return run_trials(trainable(), trials, shared, ResourceConfig(**resources))


def attempts(folder):
    notes = sorted((folder / "notes").iterdir())
    return {note.name: len(note.read_text().splitlines()) for note in notes}


def threaded(call):
    """Start a call, and return what waits for its error, which is None where it has none."""
    raised = []

    def caught():
        try:
            call()
        except BaseException as error:  # noqa: BLE001 - what is raised is what is looked at
            raised.append(error)

    thread = threading.Thread(target=caught)
    thread.start()

    def joined():
        thread.join(60.0)
        assert not thread.is_alive()
        return raised[0] if raised else None

    return joined


def wait_for(condition):
    until_s = time.monotonic() + 60.0
    while not condition():
        assert time.monotonic() < until_s
        time.sleep(0.05)


@pytest.mark.e2e
@pytest.mark.timeout(300)
@pytest.mark.usefixtures("cluster")
class TestOnACluster:
    def test_outcomes_come_in_order_with_checkpoint_metrics_and_times(self, trials, tmp_path, caplog):
        caplog.set_level(logging.INFO, "training")
        began_s = time.time()
        outcomes = run(trials, tmp_path)
        assert [outcome.name for outcome in outcomes] == list(NAMES)
        for outcome, trial in zip(outcomes, trials, strict=True):
            assert outcome.checkpoint == trial.folder / "step-000000004"
            assert outcome.metrics == {"a_loss": 0.25, "attempt": 1.0}
            assert began_s <= outcome.started_s <= outcome.ended_s <= time.time()
        # A line tells that a trial has ended, and a worker shows the name of its trial.
        ended = {message.partition(";")[0] for message in caplog.messages}
        assert ended == {f"{name} (a job): finished" for name in NAMES}
        assert (tmp_path / "notes" / "one").read_text() == "ray::stage/one\n"

    def test_finished_trials_are_not_run_again(self, trials, tmp_path):
        first = run(trials[:2], tmp_path)
        again = run(trials, tmp_path)
        assert again[:2] == first
        assert attempts(tmp_path) == dict.fromkeys(NAMES, 1)

    @pytest.mark.parametrize("fault", ["raise", DIE])
    def test_a_trial_is_tried_again_as_often_as_it_may_fail(self, fault, trials, tmp_path):
        outcomes = run(trials, tmp_path, {"two": [fault, fault]}, max_failures=2)
        assert [outcome.metrics["attempt"] for outcome in outcomes] == [1, 3, 1]

    @pytest.mark.parametrize("fault", ["raise", DIE])
    def test_one_fault_more_fails_the_job_and_the_others_finish(self, fault, trials, tmp_path):
        attempt = "attempt 2" if fault == "raise" else ""
        with pytest.raises(JobError, match=f"1 of 3 trials failed.*{attempt}"):
            run(trials, tmp_path, {"one": [fault, fault]}, max_failures=1)
        assert [read_outcome(trial) is None for trial in trials] == [True, False, False]
        # Submitted again, the job has the failed one alone to do.
        run(trials, tmp_path)
        assert attempts(tmp_path) == {"one": 3, "two": 1, "three": 1}

    def test_a_job_that_is_stopped_waits_for_those_that_run_and_starts_no_other(self, trials, tmp_path):
        plans = dict.fromkeys(NAMES, "until stopped")
        job = threaded(lambda: run(trials, tmp_path, plans))
        wait_for(lambda: (tmp_path / "notes").is_dir() and len(attempts(tmp_path)) == 2)
        trials[0].stop.touch()
        assert isinstance(job(), KeyboardInterrupt)
        ran = {name for name in NAMES if (tmp_path / "notes" / name).exists()}
        assert len(ran) == 2
        assert all((tmp_path / "notes" / f"{name}-stopped").exists() for name in ran)
        trials[0].stop.unlink()
        assert [outcome.name for outcome in run(trials, tmp_path)] == list(NAMES)

    def test_a_stopped_job_does_not_wait_for_trials_that_have_no_room(self, trials, tmp_path):
        job = threaded(lambda: run(trials, tmp_path, cpus_per_trial=3))
        trials[0].stage.mkdir(parents=True)
        time.sleep(1.0)
        trials[0].stop.touch()
        assert isinstance(job(), KeyboardInterrupt)
        assert attempts(tmp_path) == {}


def test_sigterm_is_a_request_while_trials_run_and_nothing_else_changes(tmp_path):
    before = signal.getsignal(signal.SIGTERM)
    with stop_on_sigterm(tmp_path / "stop"):
        signal.raise_signal(signal.SIGTERM)
        assert (tmp_path / "stop").exists()
    assert signal.getsignal(signal.SIGTERM) is before
