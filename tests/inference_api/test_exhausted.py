"""What a server has no room for: it says so with 503, and goes on."""

import errno
import json
import socket
import sys
from pathlib import Path

import httpx
import pytest

from cspace.bundle import Bundle
from cspace.errors import BundleError
from tests.inference_api.answers import assert_answers, assert_problem
from tests.inference_api.server import server_process


def without_memory() -> None:
    raise MemoryError


def without_threads() -> None:
    raise RuntimeError("can't start new thread")


def without_files() -> None:
    raise OSError(errno.EMFILE, "Too many open files", "/srv/secret")


def graph_without_memory() -> None:
    raise BundleError("generator.onnx failed") from MemoryError()


@pytest.mark.parametrize("fail", [without_memory, without_threads, without_files, graph_without_memory])
def test_a_machine_with_nothing_left_is_503(api, png, monkeypatch, fail):
    with monkeypatch.context() as patch:
        patch.setattr(Bundle, "answer", lambda *_, **__: fail())
        answer = api.post("/sample", files={"image": png})
    problem = assert_problem(answer, 503, "out-of-resources")
    assert "ask again" in problem["detail"]
    assert "secret" not in answer.text
    assert_answers(api)


def test_a_cache_that_cannot_be_written_is_503(start_api, registry, bundles, png, tmp_path):
    (tmp_path / "cache").write_text("a file where a folder should be")
    registry.add(bundles["plain"], "champion")
    api = start_api(registry)
    answer = api.post("/sample", files={"image": png}, data={"model": "cspace-sampler/1"})
    problem = assert_problem(answer, 503, "storage-unavailable")
    assert "CSPACE_MODEL_CACHE" in problem["detail"]
    assert_problem(answer, 503, "storage-unavailable")
    assert_answers(api)


def limited(folder: Path, limit: str) -> str:
    """An interpreter under a limit of the shell's."""
    script = folder / "python"
    script.write_text(f'#!/bin/bash\nulimit {limit}\nexec {sys.executable} "$@"\n')
    script.chmod(0o755)
    return str(script)


@pytest.mark.slow
def test_idle_connections_lock_nobody_out_where_few_files_may_be_open(tmp_path):
    with server_process(tmp_path, {}, python=limited(tmp_path, "-n 128")) as server:
        port = int(server.address.rsplit(":", 1)[1])
        idle = [socket.create_connection(("127.0.0.1", port)) for _ in range(200)]
        try:
            picture = (Path(__file__).parents[2] / "docs" / "images" / "scenario.png").read_bytes()
            for _ in range(5):
                answer = httpx.post(f"{server.address}/sample", files={"image": picture}, timeout=10)
                assert answer.status_code == 200
        finally:
            for connection in idle:
                connection.close()
        assert "at most 64 connections" in server.log.read_text()


LOADS = {"CSPACE_API_LOAD_PLANNER": "1"}


@pytest.mark.slow
def test_a_server_with_little_address_space_answers_all_but_plans(tmp_path):
    picture = (Path(__file__).parents[2] / "docs" / "images" / "scenario.png").read_bytes()
    ends = {"start": json.dumps([1.5, 0.5]), "goal": json.dumps([-1.5, 0.5])}
    options = {"files": {"image": picture}, "timeout": 60}
    with server_process(tmp_path, LOADS, python=limited(tmp_path, "-v 600000")) as server:
        assert httpx.get(f"{server.address}/health/ready", timeout=10).status_code == 200
        plan = httpx.post(f"{server.address}/plan", data=ends, **options)
        assert_problem(plan, 503, "out-of-resources")
        assert httpx.post(f"{server.address}/sample", **options).status_code == 200
