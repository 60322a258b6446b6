"""A Ray worker that is cut off from the head in the middle of a training, and comes back."""

import re
import subprocess
import time
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import httpx
import mlflow
import numpy as np
import pytest

from tests.compose.stack import JOB_LIMIT_S, Stack

pytestmark = [pytest.mark.compose, pytest.mark.timeout(3600)]

STEPS = 5000
# Every stage as short as it gets but one: two local trials of about a minute each, one of them on the worker.
LONG_LOCAL = (
    "--preset",
    "smoke",
    "--set",
    f"local.steps={STEPS}",
    "--set",
    "resources.checkpoint_every_steps=100",
)
# Ray names the node of a trial that runs elsewhere than the job.
ON_WORKER = re.compile(r"\(local/local-\d+ pid=\d+, ip=[\d.]+\).* step ")
RANDOM = np.random.default_rng(7)


@contextmanager
def training(stack: Stack, log: Path) -> Iterator[subprocess.Popen[bytes]]:
    """A training job beside the test; what it says goes into a file."""
    with log.open("wb") as out:
        command = stack.command("run", "--rm", "--no-TTY", "train", *LONG_LOCAL)
        with subprocess.Popen(
            command, cwd=stack.root, env=dict(stack.environment), stdout=out, stderr=subprocess.STDOUT
        ) as job:
            try:
                yield job
            finally:
                job.kill()


def wait_for(log: Path, seen: Callable[[str], object], job: subprocess.Popen[bytes]) -> None:
    until = time.monotonic() + JOB_LIMIT_S
    while not seen(text := log.read_text(encoding="utf-8", errors="replace")):
        assert job.poll() is None, text[-4000:]
        assert time.monotonic() < until, text[-4000:]
        time.sleep(0.2)


# Ray gives a node up after about a minute.
@pytest.mark.parametrize("away_s", [8.0, 75.0], ids=["back_soon", "given_up"])
def test_a_training_completes_without_a_gap_although_its_worker_was_cut_off(
    stack: Stack, untrained: httpx.Response, tmp_path: Path, away_s: float
) -> None:
    log = tmp_path / "job.log"
    with training(stack, log) as job:
        wait_for(log, ON_WORKER.search, job)
        time.sleep(RANDOM.uniform(0, 10))
        stack.disconnect("ray-worker")
        time.sleep(away_s)
        stack.connect("ray-worker")
        code = job.wait(JOB_LIMIT_S)
    said = log.read_text(encoding="utf-8", errors="replace")
    assert code == 0, said[-4000:]
    result = stack.read_result(said)
    assert_every_trial_is_whole(stack, str(result["run_id"]))
    stack.start()


def assert_every_trial_is_whole(stack: Stack, parent: str) -> None:
    """One finished run for each trial, whose curve has no gap and no step twice."""
    client = mlflow.MlflowClient(stack.url("MLFLOW"))
    experiment = client.get_run(parent).info.experiment_id
    runs = client.search_runs([experiment], f"tags.`mlflow.parentRunId` = '{parent}'")
    names = Counter(run.data.tags["trial"] for run in runs)
    assert names == Counter(["vae", "validity", "local-0", "local-1", "global"])
    assert {run.info.status for run in runs} == {"FINISHED"}
    for run in runs:
        if run.data.tags["trial"] not in {"local-0", "local-1"}:
            continue
        history = client.get_metric_history(run.info.run_id, "critic_loss")
        steps = Counter(point.step for point in history)
        assert {1, *range(2, STEPS + 1, 2)} - set(steps) == set()
        assert max(steps.values()) == 1, steps.most_common(3)
