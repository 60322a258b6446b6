"""Several processes behind one port, as real ones."""

import os
import signal
from collections.abc import Iterator
from contextlib import ExitStack, suppress
from pathlib import Path

import httpx
import psutil
import pytest

from inference_api.__main__ import main
from inference_api.settings import usable_cores
from tests.inference_api.raw import metric, until
from tests.inference_api.server import ServerProcess, server_process

pytestmark = pytest.mark.e2e

REQUESTS = 40
PATIENCE_S = 60.0


@pytest.fixture(scope="module")
def server(tmp_path_factory: pytest.TempPathFactory, bundles: dict[str, Path]) -> Iterator[ServerProcess]:
    chosen = {"CSPACE_PRETRAINED_MODEL": str(bundles["plain"])}
    with server_process(tmp_path_factory.mktemp("workers"), chosen, "--workers", "2") as found:
        yield found


def workers(server: ServerProcess) -> set[int]:
    """Process ids of those that answer."""
    found = set()
    for child in psutil.Process(server.process.pid).children():
        with suppress(psutil.Error):
            if "spawn_main" in " ".join(child.cmdline()):
                found.add(child.pid)
    return found


def ask(server: ServerProcess, png: bytes, seed: int) -> list[list[float]]:
    """A connection of its own, so that any process may take it."""
    fields = {"n": "5", "seed": str(seed)}
    answer = httpx.post(f"{server.address}/sample", files={"image": png}, data=fields)
    assert answer.status_code == 200
    samples: list[list[float]] = answer.json()["samples"]
    return samples


def answered(server: ServerProcess) -> float:
    lines = httpx.get(f"{server.address}/metrics").text.splitlines()
    name = 'cspace_requests_total{method="POST",route="/sample",status="200"}'
    return sum(float(line.rsplit(" ", 1)[1]) for line in lines if line.startswith(name))


def test_the_cores_are_shared_out(server: ServerProcess) -> None:
    shared = {psutil.Process(worker).environ()["CSPACE_API_THREADS"] for worker in workers(server)}
    assert shared == {str(max(1, usable_cores() // 2))}


def test_all_processes_answer_alike_and_count_together(server: ServerProcess, png: bytes) -> None:
    before = answered(server)
    found = [ask(server, png, 7) for _ in range(REQUESTS)]
    assert all(samples == found[0] for samples in found)
    # Whichever process is asked tells of all.
    assert {answered(server) for _ in range(10)} == {before + REQUESTS}
    assert "cspace_model_info{" in httpx.get(f"{server.address}/metrics").text
    assert len(workers(server)) == 2


def test_connections_that_are_kept_are_shared_out(server: ServerProcess) -> None:
    port = httpx.URL(server.address).port
    with ExitStack() as kept:
        for _ in range(REQUESTS):
            client = kept.enter_context(httpx.Client(base_url=server.address))
            assert client.get("/health/live").status_code == 200
        held = {
            worker: sum(
                connection.status == psutil.CONN_ESTABLISHED and connection.laddr.port == port
                for connection in psutil.Process(worker).net_connections()
            )
            for worker in workers(server)
        }
    # Each gets half on average; fewer than a tenth of them would come about once in a hundred million times.
    assert sum(held.values()) == REQUESTS
    assert min(held.values()) >= REQUESTS // 10


def test_a_port_that_processes_share_is_taken_for_others(
    server: ServerProcess, capsys: pytest.CaptureFixture[str]
) -> None:
    port = str(httpx.URL(server.address).port)
    for alone in ([], ["--workers", "2"]):
        assert main(["--port", port, *alone]) == 1
        assert f"cannot listen on 127.0.0.1:{port}" in capsys.readouterr().err


def test_a_process_that_dies_is_replaced_and_its_gauges_go(server: ServerProcess, png: bytes) -> None:
    first = workers(server)
    gone = min(first)
    with ExitStack() as kept:
        for _ in range(REQUESTS):
            client = kept.enter_context(httpx.Client(base_url=server.address))
            assert client.get("/health/live").status_code == 200
        assert metric(server.address, "cspace_connections") >= REQUESTS
        os.kill(gone, signal.SIGKILL)
        until(lambda: gone not in workers(server) and len(workers(server)) == 2, PATIENCE_S)
    until(lambda: metric(server.address, "cspace_connections") <= 1, PATIENCE_S)
    for seed in range(20):
        ask(server, png, seed)


def test_a_number_of_processes_that_can_not_be_is_refused(capsys: pytest.CaptureFixture[str]) -> None:
    for text in ("0", "two", "1.5"):
        with pytest.raises(SystemExit) as ended:
            main(["--workers", text])
        assert ended.value.code == 2
        assert "at least 1" in capsys.readouterr().err
