"""Up, down and status with a real supervisord: stubs in place of the services."""

import socket
import subprocess
import time
from collections.abc import Callable
from pathlib import Path

import psutil
import pytest

from cspace.errors import PortTakenError, ServiceError
from cspace.files import holding
from services.local.stack import BIN, SERVICES, Settings, connect, down, drop_state, leftovers, status, up
from tests.services.local.conftest import STUB, WriteStub, ignore, settings_in

pytestmark = pytest.mark.usefixtures("programs")


def pids(settings: Settings) -> dict[str, int]:
    return {info["name"]: info["pid"] for info in connect(settings).getAllProcessInfo() if info["pid"]}


def supervisord(settings: Settings) -> psutil.Process:
    return psutil.Process(connect(settings).getPID())


def wait_for(holds: Callable[[], bool], limit_s: float = 30.0) -> None:
    until = time.monotonic() + limit_s
    while not holds():
        assert time.monotonic() < until, "it did not come to that"
        time.sleep(0.2)


def test_up_starts_services_and_down_ends_them_with_all_that_they_started(settings: Settings) -> None:
    said: list[str] = []
    up(settings, SERVICES, said.append)
    table, healthy = status(settings)
    assert healthy
    assert [line.split()[0] for line in table.splitlines()[1:]] == list(SERVICES)
    # What users may run themselves.
    supervisorctl = [BIN / "supervisorctl", "-c", settings.home / "run" / "supervisord.conf", "tail", "api"]
    tail = subprocess.run(supervisorctl, capture_output=True, text=True, check=True)
    assert settings.url("api") in tail.stdout
    # supervisord, and each stub with the process that has left its group.
    processes = leftovers(settings)
    assert len(processes) == 7
    listening = [
        c for c in supervisord(settings).net_connections(kind="inet") if c.status == psutil.CONN_LISTEN
    ]
    assert listening == []
    assert down(settings, said.append)
    assert not any(process.is_running() for process in processes)
    assert status(settings)[0].count("not running") == 3
    assert not down(settings, ignore)


def test_an_api_without_a_registry_restarts_once_there_is_one(
    settings: Settings, write_stub: WriteStub
) -> None:
    write_stub(
        "python",
        STUB.replace(
            "import http", "import os; print(os.environ.get('MLFLOW_TRACKING_URI'))\nimport http", 1
        ),
    )
    up(settings, ["api"], ignore)
    first = pids(settings)["api"]
    up(settings, ["viewer"], ignore)
    assert pids(settings)["api"] == first
    up(settings, ["mlflow", "api"], ignore)
    log = (settings.home / "logs" / "api.log").read_text()
    assert [line for line in log.splitlines() if line in ("None", settings.url("mlflow"))] == [
        "None",
        settings.url("mlflow"),
    ]


def test_a_killed_service_is_started_again_by_supervisord(settings: Settings) -> None:
    up(settings, SERVICES, ignore)
    first = pids(settings)["mlflow"]
    psutil.Process(first).kill()
    wait_for(lambda: pids(settings).get("mlflow", first) != first and status(settings)[1])


def test_what_a_killed_supervisord_left_behind_is_ended_by_down_and_replaced_by_up(
    settings: Settings,
) -> None:
    for command in (lambda: down(settings, ignore), lambda: up(settings, SERVICES, ignore)):
        up(settings, SERVICES, ignore)
        left = leftovers(settings)
        supervisord(settings).kill()
        wait_for(lambda: connect(settings) is None)
        assert not status(settings)[1]
        command()
        assert not any(process.is_running() for process in left)
    assert status(settings)[1]


def test_two_state_folders_do_not_disturb_each_other(settings: Settings, tmp_path: Path) -> None:
    other = settings_in(tmp_path / "other")
    up(settings, SERVICES, ignore)
    try:
        up(other, SERVICES, ignore)
        assert leftovers(settings).isdisjoint(leftovers(other))
    finally:
        down(other, ignore)
        drop_state(other)
    assert not leftovers(other)
    assert status(settings)[1]


def test_a_strangers_port_is_refused_by_its_number_before_anything_starts(settings: Settings) -> None:
    with (
        socket.create_server(("127.0.0.1", settings.ray_port)),
        pytest.raises(PortTakenError, match=f"port {settings.ray_port} of ray.*CSPACE_RAY_PORT"),
    ):
        up(settings, SERVICES, ignore)
    assert not leftovers(settings)


def test_a_service_that_ends_while_it_starts_shows_its_log_and_the_others_go_on(
    settings: Settings, write_stub: WriteStub
) -> None:
    write_stub("mlflow", "#!/bin/sh\necho this is why\nexit 3\n")
    with pytest.raises(ServiceError, match=r"(?s)mlflow ended while it was starting.*this is why"):
        up(settings, SERVICES, ignore)
    assert pids(settings).keys() == {"ray", "api"}


def test_services_on_other_ports_are_told_instead_of_started_twice(settings: Settings) -> None:
    up(settings, ["api"], ignore)
    moved = settings.model_copy(update={"mlflow_port": 1})
    with pytest.raises(ServiceError, match="`make down` first"):
        up(moved, ["api"], ignore)
    assert down(moved, ignore)


def test_two_commands_at_a_time_are_one_too_many(settings: Settings) -> None:
    up(settings, ["api"], ignore)
    busy = pytest.raises(ServiceError, match="another command")
    with holding(settings.home / "run" / "lock", ServiceError("held")), busy:
        down(settings, ignore)
