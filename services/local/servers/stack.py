"""The services of this machine together: up, down and what they are doing."""

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

from cspace.errors import ServiceError, ServiceStartError
from services.local.servers.api_server import api_server
from services.local.servers.health import wait_ready
from services.local.servers.lock import exclusive
from services.local.servers.mlflow_server import mlflow_server
from services.local.servers.ports import require_free
from services.local.servers.processes import family, is_alive, start_detached, stop, with_children
from services.local.servers.ray_head import ray_head
from services.local.servers.records import Record, drop_record, read_record, write_record
from services.local.servers.service import Service
from services.local.settings import HOME, Settings

Report = Callable[[str], None]


@dataclass(frozen=True, slots=True)
class ServiceStatus:
    """One service as it is now; ``pid`` and ``since`` (Unix time in s) are None where it does not run."""

    title: str
    address: str
    pid: int | None
    since: float | None
    healthy: bool

    @property
    def running(self) -> bool:
        """Whether its process runs."""
        return self.pid is not None


def services(settings: Settings) -> tuple[Service, ...]:
    """All services in the order in which they are started; they end in the reverse."""
    return (mlflow_server(settings), ray_head(settings), api_server(settings))


def up(settings: Settings, wanted: Sequence[Service], report: Report) -> None:
    """Start what does not run, all beside each other, and wait until everything is ready.

    Raises:
        PortTakenError: a stranger listens on a port; nothing was started.
        ServiceError: the services belong to another checkout or to other settings.
        ServiceStartError: one did not come up; it was ended again, the others go on.
    """
    settings.make_folders()
    with exclusive(settings.run_folder):
        began = time.monotonic()
        absent = [service for service in wanted if not _runs(settings, service)]
        for service in absent:
            _end_leftovers(settings, service)
            require_free(service.port, service.title, service.setting)
        for service in absent:
            service.prepare()
        for service in absent:
            _start(settings, service)
            report(f"{service.title}: starting, log {_log(settings, service)}")
        for service in wanted:
            record = _wait(settings, service)
            write_record(settings.run_folder, with_children(record))
            state = f"ready after {time.monotonic() - began:.1f} s" if service in absent else "runs already"
            report(f"{service.title}: {state}, {service.address}")


def down(settings: Settings, wanted: Sequence[Service], report: Report) -> int:
    """End what was started here, by process id; how many services ran. What that interrupts is told first.

    Raises:
        ServiceError: a service belongs to another checkout; nothing was ended.
    """
    if not settings.run_folder.is_dir():
        return 0
    ended = 0
    with exclusive(settings.run_folder):
        found = [(service, read_record(settings.run_folder, service.name)) for service in reversed(wanted)]
        records = [(service, record) for service, record in found if record is not None]
        for service, record in records:
            if Path(record.root).is_dir() and (is_alive(record) or family(record)):
                _require_own(settings, service, record)
        for service, record in records:
            if is_alive(record) and record.address == service.address:
                for line in service.interrupts():
                    report(line)
        for service, record in records:
            ended += is_alive(record)
            count = stop(record, service.stop_grace_s)
            drop_record(settings.run_folder, service.name)
            report(f"{service.title}: ended" if count else f"{service.title}: had ended before")
    return ended


def status(settings: Settings, wanted: Sequence[Service]) -> list[ServiceStatus]:
    """What each service is doing."""
    return [_status(service, read_record(settings.run_folder, service.name)) for service in wanted]


def require_down(settings: Settings, wanted: Sequence[Service]) -> None:
    """Raise ServiceError where a service or something that it started still runs."""
    records = [read_record(settings.run_folder, service.name) for service in wanted]
    alive = [record.service for record in records if record and (is_alive(record) or family(record))]
    if alive:
        raise ServiceError("services still run", got=", ".join(alive), remedy="`make down` first")


def _status(service: Service, record: Record | None) -> ServiceStatus:
    if record is None or not is_alive(record):
        return ServiceStatus(service.title, service.address, None, None, healthy=False)
    # A service that was started on another port is asked there.
    healthy = record.address == service.address and service.ready()
    return ServiceStatus(service.title, record.address, record.pid, record.create_time, healthy)


def _runs(settings: Settings, service: Service) -> bool:
    record = read_record(settings.run_folder, service.name)
    if record is None or not is_alive(record):
        return False
    _require_own(settings, service, record)
    if record.address != service.address:
        raise ServiceError(
            f"{service.title} runs at another address",
            expected=service.address,
            got=record.address,
            remedy=f"`make down` first, or set {service.setting} to the port that is in use",
        )
    return True


def _require_own(settings: Settings, service: Service, record: Record) -> None:
    if Path(record.root) != settings.root:
        raise ServiceError(
            f"{service.title} runs from another checkout",
            expected=str(settings.root),
            got=record.root,
            remedy=f"`make down` there, or set {HOME} and the ports to others for this checkout",
        )


def _end_leftovers(settings: Settings, service: Service) -> None:
    """What a killed service left behind would hold its ports."""
    record = read_record(settings.run_folder, service.name)
    if record is not None:
        stop(record, service.stop_grace_s)
        drop_record(settings.run_folder, service.name)


def _start(settings: Settings, service: Service) -> None:
    record = start_detached(
        service.name,
        service.command(),
        environment=service.environment,
        folder=service.folder,
        log=_log(settings, service),
        root=settings.root,
        address=service.address,
    )
    write_record(settings.run_folder, record)


def _wait(settings: Settings, service: Service) -> Record:
    record = read_record(settings.run_folder, service.name)
    if record is None:
        raise ServiceError(f"the record of {service.title} is gone", remedy="`make down`, then `make up`")
    try:
        wait_ready(
            service.title,
            Path(record.log),
            ready=service.ready,
            alive=lambda: is_alive(record),
            limit_s=service.start_limit_s,
        )
    except ServiceStartError:
        stop(record, service.stop_grace_s)
        drop_record(settings.run_folder, service.name)
        raise
    return record


def _log(settings: Settings, service: Service) -> Path:
    return settings.logs_folder / f"{service.name}.log"
