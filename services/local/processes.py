"""Detached processes of this machine: started, recorded, watched and ended by process id."""

import socket
import subprocess
import uuid
from collections.abc import Callable, Mapping, Sequence
from contextlib import AbstractContextManager, suppress
from dataclasses import asdict, dataclass, replace
from pathlib import Path

import httpx
import psutil
from pydantic import ValidationError

from cspace.errors import PortTakenError, ServiceError, ServiceStartError
from cspace.files import holding, write_json
from cspace.strict_json import adapter_of, refused
from services.local.settings import HOST


def exclusive(folder: Path) -> AbstractContextManager[None]:
    """Hold the lock of a folder.

    Raises:
        ServiceError: another command holds it.
    """
    busy = ServiceError(
        "another command is starting or ending these services", remedy="wait for it, then run yours again"
    )
    return holding(folder / "lock", busy)


def is_free(port: int) -> bool:
    """Whether nobody listens on a loopback port and a service could."""
    with socket.socket() as client:
        client.settimeout(1.0)
        # A listener on all addresses lets others bind the loopback address on some systems.
        if client.connect_ex((HOST, port)) == 0:
            return False
    with socket.socket() as server:
        server.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            server.bind((HOST, port))
        except OSError:
            return False
    return True


def require_free(port: int, service: str, setting: str) -> None:
    """Raise PortTakenError, naming the setting to change, where a port is not free."""
    if is_free(port):
        return
    raise PortTakenError(
        f"port {port} of {service} is taken",
        expected="a free port",
        got=holder(port) or "a listener of another user",
        remedy=f"end that process, or set {setting} to a free port and run the command again",
    )


def holder(port: int) -> str | None:
    """Who listens on a port as text, or None where the system does not tell."""
    try:
        connections = psutil.net_connections(kind="tcp")
    except psutil.Error:
        return None
    for connection in connections:
        listens = connection.status == psutil.CONN_LISTEN
        if listens and connection.laddr and connection.laddr.port == port and connection.pid:
            with suppress(psutil.Error):
                command = " ".join(psutil.Process(connection.pid).cmdline())
                return f"process {connection.pid}: {command[:120]}"
            return f"process {connection.pid}"
    return None


def free_ports(count: int) -> list[int]:
    """Different free loopback ports, chosen by the system."""
    sockets = [socket.socket() for _ in range(count)]
    try:
        for one in sockets:
            one.bind((HOST, 0))
        return [int(one.getsockname()[1]) for one in sockets]
    finally:
        for one in sockets:
            one.close()


@dataclass(frozen=True, slots=True)
class ProcessId:
    """A process for good: its id and when it came to be (Unix time in s), as ids are used again."""

    pid: int
    create_time: float


@dataclass(frozen=True, slots=True)
class Record(ProcessId):
    """A process that was started here.

    Args:
        service: short name of the service.
        marker: a value in the environment of the process and all that it starts.
        root: the project that it was started from.
        address: where it listens.
        log: its log file.
        children: what it had started when it was ready. Programs that write a title of their own into their
            process wipe out the marker, and Ray's agents do.
    """

    service: str
    marker: str
    root: str
    address: str
    log: str
    children: tuple[ProcessId, ...] = ()


def write_record(folder: Path, record: Record) -> None:
    """Keep a record; a reader sees the old one or the new one."""
    write_json(_path(folder, record.service), asdict(record), indent=1)


def read_record(folder: Path, service: str) -> Record | None:
    """The record of a service, None if it has none.

    Raises:
        ServiceError: the file is not a record.
    """
    path = _path(folder, service)
    try:
        record: Record = adapter_of(Record).validate_json(path.read_bytes())
    except FileNotFoundError:
        return None
    except ValidationError as error:
        remedy = "end the process that it was about, if there is one, and delete the file"
        raise refused(error, ServiceError, f"the record {path}", remedy) from error
    return record


def drop_record(folder: Path, service: str) -> None:
    """Forget a service."""
    _path(folder, service).unlink(missing_ok=True)


def _path(folder: Path, service: str) -> Path:
    return folder / f"{service}.json"


MARKER = "CSPACE_SERVICE_ID"
# Clocks of processes are read in ticks of 0.01 s from a boot time that may be corrected by parts of a second.
CREATE_TIME_TOLERANCE_S = 1.0
KILL_WAIT_S = 5.0


class _Detached(subprocess.Popen[bytes]):
    def __del__(self) -> None:
        """Say nothing: the process is meant to go on, and its record is what ends it."""


def start_detached(
    service: str,
    argv: Sequence[str],
    *,
    environment: Mapping[str, str],
    folder: Path,
    log: Path,
    root: Path,
    address: str,
) -> Record:
    """Start a process in a session of its own, its output appended to a log.

    Raises:
        ServiceStartError: the program cannot be started.
    """
    marker = f"{service}-{uuid.uuid4()}"
    try:
        with log.open("ab") as output:
            process = _Detached(
                list(argv),
                env={**environment, MARKER: marker},
                cwd=folder,
                stdin=subprocess.DEVNULL,
                stdout=output,
                stderr=subprocess.STDOUT,
                start_new_session=True,
            )
        created = psutil.Process(process.pid).create_time()
    except (OSError, psutil.Error) as error:
        raise ServiceStartError(f"{service} cannot be started", got=str(error)) from error
    return Record(process.pid, created, service, marker, str(root), address, str(log))


def find(known: ProcessId) -> psutil.Process | None:
    """A process if it still runs: the same id *and* the same creation time."""
    with suppress(psutil.Error):
        process = psutil.Process(known.pid)
        if abs(process.create_time() - known.create_time) < CREATE_TIME_TOLERANCE_S and _runs(process):
            return process
    return None


def is_alive(record: Record) -> bool:
    """Whether the recorded process still runs."""
    return find(record) is not None


def with_children(record: Record) -> Record:
    """The record with all that its process has started so far."""
    children = []
    for process in family(record):
        with suppress(psutil.Error):  # it may end in between
            children.append(ProcessId(process.pid, process.create_time()))
    return replace(record, children=tuple(children))


def family(record: Record) -> list[psutil.Process]:
    """All that the recorded process has started and that still runs, without the process itself."""
    known = [find(one) for one in (record, *record.children)]
    # Where a process may not be looked into, its environment is None.
    marked = [
        process
        for process in psutil.process_iter(["environ"])
        if (process.info["environ"] or {}).get(MARKER) == record.marker
    ]
    found = {process.pid: process for process in [*known, *marked] if process is not None}
    for process in list(found.values()):
        with suppress(psutil.Error):  # it may end in between
            found |= {child.pid: child for child in process.children(recursive=True)}
    return [process for process in found.values() if process.pid != record.pid and _runs(process)]


def stop(record: Record, grace_s: float) -> int:
    """End the recorded process and all that it started; how many processes that were.

    The process is asked first and given time to end its own children in order; then those that are left are
    asked, and at last killed. A stranger with a recorded id is left alone.
    """
    root, children = find(record), family(record)
    ended = {process.pid for process in children}
    if root is not None:
        ended.add(root.pid)
        _end([root], grace_s)
    # Children may have started others while they were ending.
    left = {process.pid: process for process in [*children, *family(record)] if _runs(process)}
    _end(list(left.values()), KILL_WAIT_S)
    return len(ended | set(left))


def _end(processes: Sequence[psutil.Process], grace_s: float) -> None:
    """Ask processes to end, and kill those that have not after a time.

    psutil compares creation times before it sends a signal, so that a reused id is never hit.
    """
    for process in processes:
        with suppress(psutil.Error):
            process.terminate()
    _, alive = psutil.wait_procs(processes, timeout=grace_s)
    for process in alive:
        with suppress(psutil.Error):
            process.kill()
    psutil.wait_procs(alive, timeout=KILL_WAIT_S)


def _runs(process: psutil.Process) -> bool:
    try:
        return process.is_running() and process.status() != psutil.STATUS_ZOMBIE
    except psutil.Error:
        return False


PROBE_TIMEOUT_S = 5.0


def answers(url: str, headers: Mapping[str, str] | None = None) -> bool:
    """Whether an address answers with a status of 200."""
    return answer_of(url, headers) is not None


def answer_of(url: str, headers: Mapping[str, str] | None = None) -> bytes | None:
    """What an address answers with a status of 200; None where it does not."""
    with suppress(httpx.HTTPError):
        answer = _get(url, headers)
        if answer.status_code == httpx.codes.OK:
            return answer.content
    return None


def problem_at(url: str) -> str:
    """The ``type`` of the problem that an address answers; empty where it answers none."""
    with suppress(httpx.HTTPError, ValueError, KeyError, TypeError):
        return str(_get(url).json()["type"])
    return ""


def _get(url: str, headers: Mapping[str, str] | None = None) -> httpx.Response:
    # Loopback addresses are never reached through a proxy.
    return httpx.get(url, headers=headers, timeout=PROBE_TIMEOUT_S, trust_env=False)


@dataclass(frozen=True, slots=True)
class Service:
    """One process of the stack with its readiness.

    Args:
        name: short, for records and logs.
        title: for people.
        address: where it listens.
        port: of that address.
        setting: the environment variable that moves the port.
        command: makes the command line.
        environment: of the process.
        folder: that it runs in.
        ready: whether it does its work.
        start_limit_s: how long it may take until it is ready.
        stop_grace_s: how long it may take to end by itself.
        prepare: run before each start.
        interrupts: tells in lines which work its end would interrupt.
    """

    name: str
    title: str
    address: str
    port: int
    setting: str
    command: Callable[[], tuple[str, ...]]
    environment: Mapping[str, str]
    folder: Path
    ready: Callable[[], bool]
    start_limit_s: float
    stop_grace_s: float
    prepare: Callable[[], None] = lambda: None
    interrupts: Callable[[], Sequence[str]] = lambda: ()
