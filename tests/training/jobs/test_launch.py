"""Trials by Tune on a real Ray: what is recorded, retried, and gone on with."""

import os
import signal
from pathlib import Path
from types import SimpleNamespace

import pytest

from cspace.errors import JobError
from tests.training.jobs.ray_nodes import ray_nodes
from training.config import ResourceConfig
from training.jobs.job import Environment
from training.jobs.launch import FINAL, run_trials

NAMES = ("one", "two", "three")
# Each death costs a new worker's start.
DIE = pytest.param("die", marks=pytest.mark.slow)


@pytest.fixture(scope="module")
def cluster():
    """Room for two trials at once."""
    with ray_nodes([{"num_cpus": 2}]) as ids:
        yield ids


def trainable():
    """A trial that notes each attempt, does what is planned for it, and leaves a checkpoint of a step."""

    def train(trial, train, notes, plans):
        del train
        from tests.training.models.builders import save, tiny_module
        from training.jobs.launch import LAST

        with Path(notes, trial.name).open("a") as file:
            file.write("attempt\n")
        attempt = len(Path(notes, trial.name).read_text().splitlines())
        plan = plans.get(trial.name, ())
        if attempt <= len(plan) and plan[attempt - 1] == "raise":
            raise ValueError(f"attempt {attempt}")
        if attempt <= len(plan) and plan[attempt - 1] == "die":
            os.kill(os.getpid(), signal.SIGKILL)
        save(
            trial.folder / LAST, tiny_module(), [{"step": 4.0, "time_ms": 5000.0, "attempt": float(attempt)}]
        )

    return train


def run(folder, plans=None, names=NAMES, **resources):
    """The outcomes of trials of these plans."""
    notes = folder / "notes"
    notes.mkdir(exist_ok=True)
    job = SimpleNamespace(
        config=SimpleNamespace(seed=0, resources=ResourceConfig(**resources)),
        environment=Environment("unused", folder),
        folder=folder / "job",
        name="a-job",
        child=lambda name: name,
    )
    return run_trials(job, "stage", names, trainable(), notes=str(notes), plans=plans or {})


def final(folder, name):
    return folder / "job" / "stage" / name / FINAL


def attempts(folder):
    notes = sorted((folder / "notes").iterdir())
    return {note.name: len(note.read_text().splitlines()) for note in notes}


@pytest.mark.e2e
@pytest.mark.timeout(300)
@pytest.mark.usefixtures("cluster")
class TestOnACluster:
    def test_outcomes_come_in_order_with_checkpoint_metrics_and_times(self, tmp_path):
        outcomes = run(tmp_path)
        assert [outcome.name for outcome in outcomes] == list(NAMES)
        for outcome in outcomes:
            assert outcome.checkpoint == final(tmp_path, outcome.name)
            assert (outcome.metrics, outcome.times_s) == ({"attempt": 1.0}, (5.0, 5.0))

    def test_finished_trials_are_not_run_again(self, tmp_path):
        first = run(tmp_path, names=NAMES[:2])
        assert run(tmp_path)[:2] == first
        assert attempts(tmp_path) == dict.fromkeys(NAMES, 1)

    @pytest.mark.parametrize("fault", ["raise", DIE])
    def test_a_trial_is_tried_again_as_often_as_it_may_fail(self, fault, tmp_path):
        outcomes = run(tmp_path, {"two": [fault, fault]}, max_failures=2)
        assert [outcome.metrics["attempt"] for outcome in outcomes] == [1, 3, 1]

    @pytest.mark.parametrize("fault", ["raise", DIE])
    def test_one_fault_more_fails_the_job_and_the_others_finish(self, fault, tmp_path):
        attempt = "attempt 2" if fault == "raise" else ""
        with pytest.raises(JobError, match=f"1 of 3 trials failed.*{attempt}"):
            run(tmp_path, {"one": [fault, fault]}, max_failures=1)
        assert [final(tmp_path, name).exists() for name in NAMES] == [False, True, True]
        # Submitted again, the job has the failed one alone to do.
        run(tmp_path)
        assert attempts(tmp_path) == {"one": 3, "two": 1, "three": 1}
