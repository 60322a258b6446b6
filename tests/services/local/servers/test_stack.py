"""Up, down and status with real processes: tiny HTTP servers in place of the services."""

import os
import socket
import sys
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path

import psutil
import pytest

from cspace.errors import PortTakenError, ServiceError, ServiceStartError
from services.local.processes import Service, answers, exclusive, free_ports, read_record
from services.local.settings import Settings
from services.local.stack import down, require_down, status, up

SERVER = """
import http.server, sys
http.server.HTTPServer(("127.0.0.1", int(sys.argv[1])), http.server.SimpleHTTPRequestHandler).serve_forever()
"""
MakeService = Callable[..., Service]


def ignore(line: str) -> None:
    """Nobody reads."""


@pytest.fixture
def make_service(settings: Settings) -> Iterator[MakeService]:
    made: list[Service] = []

    def make(name: str = "one", program: str = SERVER, limit_s: float = 20.0) -> Service:
        (port,) = free_ports(1)
        address = f"http://127.0.0.1:{port}"
        service = Service(
            name=name,
            title=name.title(),
            address=address,
            port=port,
            setting=f"CSPACE_{name.upper()}_PORT",
            command=lambda: (sys.executable, "-c", program, str(port)),
            environment=os.environ,
            folder=settings.home,
            ready=lambda: answers(address),
            start_limit_s=limit_s,
            stop_grace_s=5.0,
        )
        made.append(service)
        return service

    yield make
    down(settings, made, ignore)


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


def test_a_second_up_leaves_running_services_alone(settings: Settings, make_service: MakeService) -> None:
    service = make_service()
    up(settings, [service], ignore)
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


def test_services_of_another_checkout_are_left_alone(settings: Settings, make_service: MakeService) -> None:
    service = make_service()
    up(settings, [service], ignore)
    with pytest.raises(ServiceError, match="another checkout") as raised:
        up(replace(settings, root=Path("/another/checkout")), [service], ignore)
    assert str(settings.root) in str(raised.value)
    assert "set CSPACE_HOME" in str(raised.value)
    assert status(settings, [service])[0].healthy


def test_down_leaves_the_services_of_another_checkout_alone_and_says_whose_they_are(
    settings: Settings, make_service: MakeService, tmp_path: Path
) -> None:
    service = make_service()
    up(settings, [service], ignore)
    other = tmp_path / "another"
    other.mkdir()
    with pytest.raises(ServiceError, match="another checkout") as raised:
        down(replace(settings, root=other), [service], ignore)
    assert "`make down` there" in str(raised.value)
    assert status(settings, [service])[0].healthy


def test_down_leaves_another_state_folder_alone(
    settings: Settings, make_service: MakeService, tmp_path: Path
) -> None:
    service, own = make_service(), replace(settings, home=tmp_path / "own")
    up(settings, [service], ignore)
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
    settings: Settings, make_service: MakeService
) -> None:
    service = make_service()
    up(settings, [service], ignore)
    moved = replace(service, address="http://127.0.0.1:1", port=1)
    with pytest.raises(ServiceError, match="runs at another address"):
        up(settings, [moved], ignore)
    assert status(settings, [moved])[0].running


def test_state_is_not_dropped_under_running_services(settings: Settings, make_service: MakeService) -> None:
    service = make_service()
    require_down(settings, [service])
    up(settings, [service], ignore)
    with pytest.raises(ServiceError, match="make down"):
        require_down(settings, [service])


def test_a_service_that_runs_but_does_not_answer_is_not_healthy(
    settings: Settings, make_service: MakeService
) -> None:
    service = make_service()
    up(settings, [service], ignore)
    (found,) = status(settings, [replace(service, ready=lambda: False)])
    assert (found.running, found.healthy) == (True, False)


def test_two_commands_at_a_time_are_one_too_many(settings: Settings, make_service: MakeService) -> None:
    with exclusive(settings.run_folder), pytest.raises(ServiceError, match="another command"):
        up(settings, [make_service()], ignore)


def test_down_without_state_does_nothing(settings: Settings, tmp_path: Path) -> None:
    assert down(replace(settings, home=tmp_path / "absent"), [], ignore) == 0
    assert not (tmp_path / "absent").exists()
