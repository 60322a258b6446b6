"""The services of one machine, for real: MLflow, Ray and the API from up to down."""

import ipaddress
import json
import socket
import sys
import time
import urllib.request
from collections.abc import Callable, Iterator
from pathlib import Path

import psutil
import pytest

from services.local.jobs import RayJobs, TrainingResult, follow, last_result
from services.local.processes import answers
from services.local.settings import read_token, token_headers
from services.local.stack import jobs_under_way
from tests.e2e.local_stack import NAMES, LocalStack

pytestmark = [pytest.mark.e2e, pytest.mark.timeout(900)]

STUB = "python tests/fakes/stub_job.py"


@pytest.fixture(scope="module")
def stack(tmp_path_factory: pytest.TempPathFactory) -> Iterator[LocalStack]:
    with LocalStack.unique(tmp_path_factory.mktemp("stack")).running() as running:
        yield running


def test_every_service_is_healthy_after_up(stack: LocalStack) -> None:
    table = stack.succeed("status")
    assert table.count(" healthy ") == len(NAMES)
    assert all(str(stack.pid(name)) in table for name in NAMES)
    assert str(stack.settings.home) in table


def test_the_addresses_that_up_prints_answer(stack: LocalStack) -> None:
    printed = stack.succeed("up")
    for address in (stack.settings.mlflow_url, f"{stack.settings.api_url}/docs"):
        assert address in printed
        assert answers(address)
    # The dashboard's page is open, its data are not.
    assert answers(stack.settings.ray_url)
    assert not answers(f"{stack.settings.ray_url}/api/jobs/")


def test_everything_listens_on_loopback_alone(stack: LocalStack) -> None:
    listening = [
        (process.name(), connection.laddr.ip)
        for process in stack.processes()
        for connection in process.net_connections(kind="tcp")
        if connection.status == psutil.CONN_LISTEN
    ]
    assert len(listening) > len(NAMES)
    outside = [(name, ip) for name, ip in listening if not is_loopback(ip)]
    assert outside == []


def test_up_again_leaves_every_process_as_it_is(stack: LocalStack) -> None:
    before = [stack.pid(name) for name in NAMES]
    assert stack.succeed("up").count("runs already") == len(NAMES)
    assert [stack.pid(name) for name in NAMES] == before


def test_a_plain_ray_job_submit_works_in_the_shell_that_is_described(stack: LocalStack) -> None:
    outcome = stack.shell(f"ray job submit -- {STUB}")
    assert outcome.returncode == 0, outcome.stdout
    said = json.loads(outcome.stdout.split("RESULT ", 1)[1].splitlines()[0])["environment"]
    settings = stack.settings
    assert said == {
        "MLFLOW_TRACKING_URI": settings.mlflow_url,
        "CSPACE_DATA_DIR": str(settings.data_folder),
        "RAY_AUTH_MODE": "token",
        "OMP_NUM_THREADS": "1",
        "PYTHONPATH": str(settings.root),
        "folder": str(settings.root),
        "python": said["python"],
    }
    assert Path(said["python"]).parent == Path(sys.executable).parent


def test_a_job_is_followed_to_its_result(stack: LocalStack, monkeypatch: pytest.MonkeyPatch) -> None:
    token = read_token(stack.environment)
    assert token is not None
    monkeypatch.setenv("RAY_AUTH_TOKEN", token)
    jobs, lines = RayJobs(stack.settings), []
    log = follow(jobs, jobs.submit(STUB), lines.append)
    assert last_result(log, TrainingResult).reference == "stub/1"
    assert lines.index("step 1 of 2") < lines.index("step 2 of 2")


@pytest.mark.slow
def test_a_job_knows_rays_id_of_it_and_is_told_while_it_runs(
    stack: LocalStack, monkeypatch: pytest.MonkeyPatch
) -> None:
    token = read_token(stack.environment)
    assert token is not None
    monkeypatch.setenv("RAY_AUTH_TOKEN", token)
    jobs = RayJobs(stack.settings)
    says = "from training.jobs.environment import submission_id; print(submission_id(), flush=True)"
    job = jobs.submit(f"{sys.executable} -c '{says}; import time; time.sleep(300)'")
    wait_for(lambda: job in jobs.log(job).split())
    listed = jobs_under_way(stack.settings.ray_url, token_headers())
    assert [line.startswith(f"  {job}, since 20") for line in listed] == [False, True]
    assert stack.shell(f"ray job stop {job}").returncode == 0
    assert jobs_under_way(stack.settings.ray_url, token_headers()) == ()


def test_a_failing_job_ends_quickstart_with_1_and_the_end_of_its_log(stack: LocalStack) -> None:
    outcome = stack.run("quickstart", "--train", f"{STUB} fail")
    assert outcome.returncode == 1, outcome.stdout
    error = outcome.stdout.split("error: ", 1)[1]
    assert "the stub was told to fail" in error
    assert "ray job logs raysubmit_" in error


def test_ray_job_stop_writes_a_checkpoint_first_and_the_job_goes_on(stack: LocalStack) -> None:
    steps = "--set vae.steps=1000000 --set resources.checkpoint_every_steps=1000000"
    job = f"python training/cluster_train.py --preset smoke --job stopped --set validity.steps=0 {steps}"
    outcome = stack.shell(f"ray job submit --no-wait --submission-id first -- {job}")
    assert outcome.returncode == 0, outcome.stdout
    wait_for(lambda: "vae (stopped, seed 0): step" in stack.shell("ray job logs first").stdout)
    outcome = stack.shell("timeout 60 ray job stop first")
    assert "was stopped" in outcome.stdout, outcome.stdout
    log = stack.shell("ray job logs first").stdout
    assert "stopped; nothing is lost: submit it again" in log
    (state,) = (stack.settings.data_folder / "jobs").glob("*/pictures/vae/step-*/state.json")
    step = json.loads(state.read_text())["step"]
    assert 0 < step < 1_000_000
    # It goes on behind that checkpoint, and is stopped once more.
    stack.shell(f"ray job submit --no-wait --submission-id second -- {job}")
    wait_for(lambda: f"vae (stopped, seed 0): step {step + 1}/" in stack.shell("ray job logs second").stdout)
    stack.shell("timeout 60 ray job stop second")


def test_state_is_not_cleaned_under_running_services(stack: LocalStack) -> None:
    assert stack.run("clean-state", "--yes").returncode == 1
    assert (stack.settings.home / "mlflow" / "mlflow.db").is_file()


@pytest.mark.parametrize("name", ["mlflow", "ray"])
def test_a_killed_service_is_replaced_by_up_with_all_that_it_left_behind(
    stack: LocalStack, name: str
) -> None:
    others = {other: stack.pid(other) for other in NAMES if other != name}
    root = psutil.Process(stack.pid(name))
    left = root.children(recursive=True)
    assert left
    root.kill()
    assert stack.run("status").returncode == 4
    stack.succeed("up")
    assert [process for process in [root, *left] if runs(process)] == []
    assert stack.succeed("status").count(" healthy ") == len(NAMES)
    assert {other: stack.pid(other) for other in others} == others


def test_experiments_outlive_down_and_no_process_does(stack: LocalStack) -> None:
    experiment = json.loads(post(f"{stack.settings.mlflow_url}/api/2.0/mlflow/experiments/create"))
    processes = stack.processes()
    assert len(processes) > len(NAMES)
    stack.succeed("down")
    assert [process for process in processes if runs(process)] == []
    assert stack.run("status").returncode == 4
    stack.succeed("up")
    url = f"{stack.settings.mlflow_url}/api/2.0/mlflow/experiments/get?experiment_id="
    assert answers(url + experiment["experiment_id"])


def test_a_strangers_port_is_an_error_before_anything_starts(tmp_path: Path) -> None:
    idle = LocalStack.unique(tmp_path)
    with socket.create_server(("127.0.0.1", idle.settings.api_port)):
        outcome = idle.run("up")
    assert outcome.returncode == 3
    assert "set CSPACE_API_PORT" in outcome.stdout
    assert "process " in outcome.stdout
    assert list(idle.settings.run_folder.glob("*.json")) == []


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
