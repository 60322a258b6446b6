"""The services of one machine, for real: MLflow, Ray and the API from up to down."""

import ipaddress
import json
import sys
import time
import urllib.request
from collections.abc import Callable, Iterator
from pathlib import Path

import httpx
import psutil
import pytest

from cspace.errors import JobError
from services.local.quickstart import last_result, run_job
from services.local.stack import SERVICES, healthy
from tests.e2e.local_stack import ROOT, LocalStack
from training.models.checkpoint import read_checkpoint

pytestmark = [pytest.mark.e2e, pytest.mark.timeout(900)]

STUB = "python tests/fakes/stub_job.py"


@pytest.fixture(scope="module")
def stack(tmp_path_factory: pytest.TempPathFactory) -> Iterator[LocalStack]:
    with LocalStack.unique(tmp_path_factory.mktemp("stack")).running() as running:
        yield running


def test_every_service_is_healthy_after_up_at_the_address_that_is_printed(stack: LocalStack) -> None:
    table = stack.succeed("status")
    assert table.count(" healthy ") == len(SERVICES)
    assert str(stack.settings.home) in table
    printed = stack.succeed("up")
    assert printed.count("runs already") == len(SERVICES)
    assert all(stack.settings.url(name) in printed and healthy(stack.settings, name) for name in SERVICES)


def test_rays_jobs_are_not_open_to_those_without_the_token(stack: LocalStack) -> None:
    answer = httpx.get(f"{stack.settings.url('ray')}/api/jobs/", trust_env=False)
    assert answer.status_code == 401


def test_everything_listens_on_loopback_alone(stack: LocalStack) -> None:
    listening = [
        (process.name(), connection.laddr.ip)
        for process in stack.processes()
        for connection in process.net_connections(kind="tcp")
        if connection.status == psutil.CONN_LISTEN
    ]
    assert len(listening) > len(SERVICES)
    outside = [(name, ip) for name, ip in listening if not is_loopback(ip)]
    assert outside == []


def test_a_plain_ray_job_submit_works_in_the_shell_that_is_described(stack: LocalStack) -> None:
    outcome = stack.shell(f"ray job submit -- {STUB}")
    assert outcome.returncode == 0, outcome.stdout
    assert last_result(outcome.stdout.splitlines()).reference == "stub/1"
    said = json.loads(outcome.stdout.split("RESULT ", 1)[1].splitlines()[0])["environment"]
    settings = stack.settings
    assert said == {
        "MLFLOW_TRACKING_URI": settings.url("mlflow"),
        "CSPACE_DATA_DIR": str(settings.home / "data"),
        "RAY_AUTH_MODE": "token",
        "OMP_NUM_THREADS": "1",
        "PYTHONPATH": str(ROOT),
        "folder": str(ROOT),
        "python": said["python"],
    }
    assert Path(said["python"]).parent == Path(sys.executable).parent


def test_a_failing_job_ends_the_main_job_with_its_lines_shown(
    stack: LocalStack, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name, value in stack.environment.items():
        monkeypatch.setenv(name, value)
    shown: list[str] = []
    with pytest.raises(JobError, match="failed"):
        run_job(stack.settings, f"{STUB} fail", shown.append)
    assert any("the stub was told to fail" in line for line in shown)


def test_a_job_that_ray_stops_goes_on_from_its_last_checkpoint(stack: LocalStack) -> None:
    steps = "--set vae.steps=1000000 --set resources.checkpoint_every_steps=20"
    job = f"python training/cluster_train.py --preset smoke --job stopped --set validity.steps=0 {steps}"
    outcome = stack.shell(f"ray job submit --no-wait --submission-id first -- {job}")
    assert outcome.returncode == 0, outcome.stdout
    wait_for(lambda: "vae (stopped, seed 0): step" in stack.shell("ray job logs first").stdout)
    outcome = stack.shell("timeout 60 ray job stop first")
    assert "was stopped" in outcome.stdout, outcome.stdout
    log = stack.shell("ray job logs first").stdout
    assert "stopped; nothing is lost: submit it again" in log
    (last,) = ((stack.settings.home / "data") / "jobs").glob("*/pictures/vae/last.ckpt")
    step = read_checkpoint(last)["global_step"]
    assert 0 < step < 1_000_000
    # It goes on behind that checkpoint, and is stopped once more.
    stack.shell(f"ray job submit --no-wait --submission-id second -- {job}")
    shown = "vae (stopped, seed 0): step"
    wait_for(lambda: shown in stack.shell("ray job logs second").stdout)
    first = stack.shell("ray job logs second").stdout.partition(shown)[2].split("/")[0]
    assert int(first) > step
    stack.shell("timeout 60 ray job stop second")


def test_state_is_not_cleaned_under_running_services(stack: LocalStack) -> None:
    assert stack.run("clean-state", "--yes").returncode == 1
    assert (stack.settings.home / "mlflow" / "mlflow.db").is_file()


def test_a_killed_ray_head_is_replaced_with_all_that_it_started(stack: LocalStack) -> None:
    first = stack.pids()
    head = psutil.Process(first["ray"])
    left = head.children(recursive=True)
    assert left
    head.kill()
    wait_for(lambda: stack.pids()["ray"] not in {0, first["ray"]} and stack.run("status").returncode == 0)
    wait_for(lambda: not any(runs(process) for process in [head, *left]))
    assert {**stack.pids(), "ray": first["ray"]} == first


def test_experiments_outlive_down_and_no_process_does(stack: LocalStack) -> None:
    experiment = json.loads(post(f"{stack.settings.url('mlflow')}/api/2.0/mlflow/experiments/create"))
    processes = stack.processes()
    assert len(processes) > len(SERVICES)
    stack.succeed("down")
    assert [process for process in processes if runs(process)] == []
    assert stack.run("status").returncode == 4
    stack.succeed("up")
    url = f"{stack.settings.url('mlflow')}/api/2.0/mlflow/experiments/get?experiment_id="
    assert httpx.get(url + experiment["experiment_id"], trust_env=False).status_code == 200


def wait_for(holds: Callable[[], bool], limit_s: float = 240.0) -> None:
    """Look again and again until something holds."""
    deadline = time.monotonic() + limit_s
    while not holds():
        assert time.monotonic() < deadline, "it did not come to that"


def runs(process: psutil.Process) -> bool:
    """Whether a process does anything still; what ended may wait for a parent that never asks."""
    return process.is_running() and process.status() != psutil.STATUS_ZOMBIE


def is_loopback(ip: str) -> bool:
    address = ipaddress.ip_address(ip)
    mapped = getattr(address, "ipv4_mapped", None)
    return (mapped or address).is_loopback


def post(url: str) -> bytes:
    body = json.dumps({"name": "kept"}).encode()
    request = urllib.request.Request(url, body, {"Content-Type": "application/json"})
    with urllib.request.build_opener(urllib.request.ProxyHandler({})).open(request, timeout=20) as answer:
        return bytes(answer.read())
