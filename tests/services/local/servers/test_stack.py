"""Up, down and status with real processes: tiny HTTP servers in place of the services."""

import os
import socket
import sys
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import psutil
import pytest

from cspace.errors import PortTakenError, ServiceError, ServiceStartError
from services.local.processes import Service, answers, exclusive, free_ports, read_record
from services.local.settings import Settings
from services.local.stack import down, require_down, status, up
from tests.services.local.conftest import settings_in

SERVER = """
import http.server, sys
http.server.HTTPServer(("127.0.0.1", int(sys.argv[1])), http.server.SimpleHTTPRequestHandler).serve_forever()
"""
MakeService = Callable[..., Service]


def ignore(line: str) -> None:
    """Nobody reads."""


def service_of(
    settings: Settings, name: str = "one", program: str = SERVER, limit_s: float = 20.0
) -> Service:
    """A program in place of a service, on a port of its own."""
    (port,) = free_ports(1)
    address = f"http://127.0.0.1:{port}"
    return Service(
        name=name,
        title=name.title(),
        address=address,
        port=port,
        setting=f"CSPACE_{name.upper()}_PORT",
        command=lambda: (sys.executable, "-Sc", program, str(port)),
        environment=os.environ,
        folder=settings.home,
        ready=lambda: answers(address),
        start_limit_s=limit_s,
        stop_grace_s=5.0,
    )


@pytest.fixture
def make_service(settings: Settings) -> Iterator[MakeService]:
    made: list[Service] = []

    def make(*given: Any, **named: Any) -> Service:
        made.append(service_of(settings, *given, **named))
        return made[-1]

    yield make
    down(settings, made, ignore)


@pytest.fixture(scope="module")
def running(tmp_path_factory: pytest.TempPathFactory) -> Iterator[tuple[Settings, Service]]:
    """One service that runs, which the tests leave alone."""
    settings = settings_in(tmp_path_factory.mktemp("running"))
    service = service_of(settings)
    up(settings, [service], ignore)
    yield settings, service
    assert down(settings, [service], ignore) == 1


def pid_of(settings: Settings, service: Service) -> int:
    record = read_record(settings.run_folder, service.name)
    assert record is not None
    return record.pid


def test_up_starts_services_and_down_ends_them(settings: Settings, make_service: MakeService) -> None:
    wanted = [make_service("one"), make_service("two")]
    up(settings, wanted, ignore)
    pids = [pid_of(settings, service) for service in wanted]
    assert [one.healthy for one in status(settings, wanted)] == [True, True]
    assert [one.pid for one in status(settings, wanted)] == pids
    assert down(settings, wanted, ignore) == 2
    assert not any(map(psutil.pid_exists, pids))
    assert [one.running for one in status(settings, wanted)] == [False, False]


def test_a_second_up_leaves_running_services_alone(running: tuple[Settings, Service]) -> None:
    settings, service = running
    pid, lines = pid_of(settings, service), []
    up(settings, [service], lines.append)
    assert pid_of(settings, service) == pid
    assert lines == [f"One: runs already, {service.address}"]


def test_a_killed_service_is_started_again(settings: Settings, make_service: MakeService) -> None:
    service = make_service()
    up(settings, [service], ignore)
    first = pid_of(settings, service)
    psutil.Process(first).kill()
    psutil.Process(first).wait(timeout=10)
    assert not status(settings, [service])[0].running
    up(settings, [service], ignore)
    assert pid_of(settings, service) != first
    assert status(settings, [service])[0].healthy


def test_a_port_taken_by_a_stranger_stops_everything_before_anything_starts(
    settings: Settings, make_service: MakeService
) -> None:
    wanted = [make_service("one"), make_service("two")]
    with (
        socket.create_server(("127.0.0.1", wanted[1].port)),
        pytest.raises(PortTakenError, match="CSPACE_TWO_PORT"),
    ):
        up(settings, wanted, ignore)
    assert [one.running for one in status(settings, wanted)] == [False, False]


def test_a_service_that_ends_while_starting_shows_the_end_of_its_log(
    settings: Settings, make_service: MakeService
) -> None:
    service = make_service(program="print('this is why'); raise SystemExit(3)")
    with pytest.raises(ServiceStartError, match=r"(?s)One ended while it was starting.*this is why"):
        up(settings, [service], ignore)
    assert read_record(settings.run_folder, service.name) is None


def test_a_service_that_does_not_answer_in_time_is_ended(
    settings: Settings, make_service: MakeService
) -> None:
    service = make_service(program="import time; print('busy', flush=True); time.sleep(300)", limit_s=0.5)
    with pytest.raises(ServiceStartError, match="did not answer within"):
        up(settings, [service], ignore)
    assert read_record(settings.run_folder, service.name) is None
    require_down(settings, [service])


def test_services_of_another_checkout_are_left_alone_and_the_error_says_whose_they_are(
    running: tuple[Settings, Service], tmp_path: Path
) -> None:
    settings, service = running
    other = replace(settings, root=tmp_path)
    with pytest.raises(ServiceError, match="another checkout") as raised:
        up(other, [service], ignore)
    assert str(settings.root) in str(raised.value)
    assert "set CSPACE_HOME" in str(raised.value)
    with pytest.raises(ServiceError, match="another checkout") as raised:
        down(other, [service], ignore)
    assert "`make down` there" in str(raised.value)
    assert status(settings, [service])[0].healthy


def test_down_leaves_another_state_folder_alone(running: tuple[Settings, Service], tmp_path: Path) -> None:
    settings, service = running
    own = replace(settings, home=tmp_path / "own")
    own.make_folders()
    assert down(own, [service], ignore) == 0
    assert status(settings, [service])[0].healthy


def test_what_a_deleted_checkout_left_running_can_be_ended(
    settings: Settings, make_service: MakeService, tmp_path: Path
) -> None:
    service, gone = make_service(), replace(settings, root=tmp_path / "gone")
    gone.root.mkdir()
    up(gone, [service], ignore)
    gone.root.rmdir()
    assert down(settings, [service], ignore) == 1


def test_what_the_end_interrupts_is_told_before_anything_ends(
    settings: Settings, make_service: MakeService
) -> None:
    one, two = make_service("one"), make_service("two")
    busy = replace(one, interrupts=lambda: ("a job runs",))
    up(settings, [busy, two], ignore)
    lines: list[str] = []
    assert down(settings, [busy, two], lines.append) == 2
    assert lines == ["a job runs", "Two: ended", "One: ended"]
    assert down(settings, [busy, two], lines.append) == 0
    assert len(lines) == 3


def test_a_changed_port_setting_is_told_instead_of_starting_a_second_service(
    running: tuple[Settings, Service],
) -> None:
    settings, service = running
    moved = replace(service, address="http://127.0.0.1:1", port=1)
    with pytest.raises(ServiceError, match="runs at another address"):
        up(settings, [moved], ignore)
    assert status(settings, [moved])[0].running


def test_state_is_not_dropped_under_running_services(running: tuple[Settings, Service]) -> None:
    settings, service = running
    require_down(settings, [replace(service, name="two")])
    with pytest.raises(ServiceError, match="make down"):
        require_down(settings, [service])


def test_a_service_that_runs_but_does_not_answer_is_not_healthy(running: tuple[Settings, Service]) -> None:
    settings, service = running
    (found,) = status(settings, [replace(service, ready=lambda: False)])
    assert (found.running, found.healthy) == (True, False)


def test_two_commands_at_a_time_are_one_too_many(settings: Settings, make_service: MakeService) -> None:
    with exclusive(settings.run_folder), pytest.raises(ServiceError, match="another command"):
        up(settings, [make_service()], ignore)


def test_down_without_state_does_nothing(settings: Settings, tmp_path: Path) -> None:
    assert down(replace(settings, home=tmp_path / "absent"), [], ignore) == 0
    assert not (tmp_path / "absent").exists()
