"""Whole jobs as Ray tasks: so many at once, their results, and what happens when one is lost."""

import os
import time
from pathlib import Path

import pytest
from ray.exceptions import RayError

from tests.training.trials.ray_nodes import ray_nodes
from training.trials.points import run_side_by_side

pytestmark = [pytest.mark.slow, pytest.mark.timeout(200)]


@pytest.fixture(scope="module")
def cluster():
    with ray_nodes([{"num_cpus": 1}]):
        yield


def through(items, job, at_once):
    looks = list(run_side_by_side(items, job, at_once, 0.2, lambda item: None))
    ended = dict(look.ended for look in looks if look.ended is not None)
    return ended, looks


def test_no_more_jobs_run_than_may_and_none_takes_a_processor(cluster, tmp_path):
    import ray

    @ray.remote(num_cpus=1)
    def trial():
        return "trained"

    def job(index):
        began = time.time()
        # Three such jobs wait for trials that need the only processor there is.
        answer = ray.get(trial.remote())
        time.sleep(1.0)
        (tmp_path / str(index)).write_text(f"{began} {time.time()}")
        return f"{answer} {index}"

    ended, looks = through(range(5), job, 3)
    assert ended == {index: f"trained {index}" for index in range(5)}
    assert max(len(look.began) for look in looks) == 3
    assert looks[-1].began == {}
    times = [tuple(map(float, path.read_text().split())) for path in tmp_path.iterdir()]
    assert max(sum(start <= moment < end for start, end in times) for moment, _ in times) in (2, 3)


def test_a_job_whose_process_dies_is_started_again(cluster, tmp_path):
    def job(index):
        mark = Path(tmp_path, str(index))
        if not mark.exists():
            mark.touch()
            os._exit(1)
        return "done"

    ended, _ = through([0, 1], job, 2)
    assert ended == {0: "done", 1: "done"}


def test_a_job_that_fails_is_told_of_and_the_others_go_on(cluster):
    def job(index):
        return 1 // index

    ended, _ = through([0, 1], job, 1)
    assert isinstance(ended[0], RayError)
    assert "ZeroDivisionError" in str(ended[0])
    assert ended[1] == 1
