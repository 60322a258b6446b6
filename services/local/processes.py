"""Detached processes of this machine: started, recorded, watched and ended by process id."""

import http.client
import json
import os
import socket
import subprocess
import time
import urllib.error
import urllib.request
import uuid
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, suppress
from dataclasses import asdict, dataclass, replace
from pathlib import Path

import psutil

from cspace.errors import PortTakenError, ServiceError, ServiceStartError
from cspace.files import holding, write_json
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
            return _describe(connection.pid)
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


def _describe(pid: int) -> str:
    try:
        command = " ".join(psutil.Process(pid).cmdline())
    except psutil.Error:
        return f"process {pid}"
    return f"process {pid}: {command[:120]}"


@dataclass(frozen=True, slots=True)
class ProcessId:
    """A process for good: its id and when it came to be, as ids are used again."""

    pid: int
    create_time: float


@dataclass(frozen=True, slots=True)
class Record:
    """A process that was started here.

    Args:
        service: short name of the service.
        pid: its process id.
        create_time: when it came to be, Unix time in s; a process id alone may be somebody else's by now.
        argv: its command line.
        marker: a value in the environment of the process and all that it starts.
        root: the project that it was started from.
        address: where it listens.
        log: its log file.
        children: what it had started when it was ready. Programs that write a title of their own into their
            process wipe out the marker, and Ray's agents do.
    """

    service: str
    pid: int
    create_time: float
    argv: tuple[str, ...]
    marker: str
    root: str
    address: str
    log: str
    children: tuple[ProcessId, ...] = ()

    @property
    def process(self) -> ProcessId:
        """The process itself."""
        return ProcessId(self.pid, self.create_time)


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
        fields = json.loads(path.read_text(encoding="utf-8"))
        children = tuple(ProcessId(**child) for child in fields["children"])
        return Record(**{**fields, "argv": tuple(fields["argv"]), "children": children})
    except FileNotFoundError:
        return None
    except (ValueError, TypeError, KeyError, UnicodeDecodeError) as error:
        raise ServiceError(
            f"the record {path} is damaged",
            got=str(error),
            remedy="end the process that it was about, if there is one, and delete the file",
        ) from error


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
    return Record(service, process.pid, created, tuple(argv), marker, str(root), address, str(log))


def find(known: ProcessId) -> psutil.Process | None:
    """A process if it still runs: the same id *and* the same creation time."""
    try:
        process = psutil.Process(known.pid)
        same = abs(process.create_time() - known.create_time) < CREATE_TIME_TOLERANCE_S
        return process if same and process.status() != psutil.STATUS_ZOMBIE else None
    except psutil.Error:
        return None


def is_alive(record: Record) -> bool:
    """Whether the recorded process still runs."""
    return find(record.process) is not None


def with_children(record: Record) -> Record:
    """The record with all that its process has started so far."""
    return replace(record, children=tuple(_ids(family(record))))


def family(record: Record) -> list[psutil.Process]:
    """All that the recorded process has started and that still runs, without the process itself."""
    known = [find(one) for one in (record.process, *record.children)]
    found = {process.pid: process for process in [*known, *_marked(record.marker)] if process is not None}
    for process in list(found.values()):
        with suppress(psutil.Error):  # it may end in between
            found |= {child.pid: child for child in process.children(recursive=True)}
    return [process for process in found.values() if process.pid != record.pid and _runs(process)]


def stop(record: Record, grace_s: float) -> int:
    """End the recorded process and all that it started; how many processes that were.

    The process is asked first and given time to end its own children in order; then those that are left are
    asked, and at last killed. A stranger with a recorded id is left alone.
    """
    root, children = find(record.process), family(record)
    ended = {process.pid for process in children}
    if root is not None:
        ended.add(root.pid)
        _end([root], grace_s)
    # Children may have started others while they were ending.
    left = {process.pid: process for process in [*children, *family(record)] if _runs(process)}
    _end(list(left.values()), KILL_WAIT_S)
    return len(ended | set(left))


def _end(processes: Sequence[psutil.Process], grace_s: float) -> None:
    for process in processes:
        _signal(process, kill=False)
    _, alive = psutil.wait_procs(processes, timeout=grace_s)
    for process in alive:
        _signal(process, kill=True)
    psutil.wait_procs(alive, timeout=KILL_WAIT_S)


def _signal(process: psutil.Process, *, kill: bool) -> None:
    # psutil compares creation times before it sends, so that a reused id is never hit.
    try:
        if kill:
            process.kill()
        else:
            process.terminate()
    except psutil.Error:
        return


def _runs(process: psutil.Process) -> bool:
    try:
        return process.is_running() and process.status() != psutil.STATUS_ZOMBIE
    except psutil.Error:
        return False


def _ids(processes: Iterable[psutil.Process]) -> Iterator[ProcessId]:
    for process in processes:
        with suppress(psutil.Error):
            yield ProcessId(process.pid, process.create_time())


def _marked(marker: str) -> Iterable[psutil.Process]:
    user = os.getuid()
    for process in psutil.process_iter():
        try:
            if process.uids().real == user and process.environ().get(MARKER) == marker:
                yield process
        except (psutil.Error, OSError):  # ended in between, or not ours to look into
            continue


PROBE_TIMEOUT_S = 5.0
POLL_S = 0.2
LOG_LINES = 25

# Loopback addresses are never reached through a proxy.
_OPENER = urllib.request.build_opener(urllib.request.ProxyHandler({}))


def answers(url: str, headers: Mapping[str, str] | None = None) -> bool:
    """Whether an address answers with a status of 200."""
    return answer_of(url, headers) is not None


def answer_of(url: str, headers: Mapping[str, str] | None = None) -> bytes | None:
    """What an address answers with a status of 200; None where it does not."""
    request = urllib.request.Request(url, headers=dict(headers or {}))  # noqa: S310 - loopback, from settings
    try:
        with _OPENER.open(request, timeout=PROBE_TIMEOUT_S) as response:
            return bytes(response.read()) if response.status == http.client.OK else None
    except (OSError, http.client.HTTPException):
        return None


def problem_at(url: str) -> str:
    """The ``type`` of the problem that an address answers; empty where it answers none."""
    try:
        _OPENER.open(url, timeout=PROBE_TIMEOUT_S).close()
    except urllib.error.HTTPError as error:
        with error, suppress(ValueError, KeyError, TypeError):
            return str(json.load(error)["type"])
    except (OSError, http.client.HTTPException):
        pass
    return ""


def wait_ready(
    title: str, log: Path, *, ready: Callable[[], bool], alive: Callable[[], bool], limit_s: float
) -> None:
    """Wait until a service is ready.

    Args:
        title: of the service, for messages.
        log: its log file, whose end is shown where it fails.
        ready: whether it answers.
        alive: whether its process runs.
        limit_s: when to give up.

    Raises:
        ServiceStartError: the process ended, or the time is up.
    """
    until = time.monotonic() + limit_s
    while not ready():
        if not alive():
            raise _failed(f"{title} ended while it was starting", log)
        if time.monotonic() > until:
            raise _failed(f"{title} did not answer within {limit_s:.0f} s", log)
        time.sleep(POLL_S)


def log_end(log: Path, lines: int = LOG_LINES) -> str:
    """The last lines of a log file."""
    try:
        text = log.read_text(encoding="utf-8", errors="replace")
    except OSError as error:
        return f"(no log: {error})"
    return "\n".join(text.splitlines()[-lines:])


def _failed(what: str, log: Path) -> ServiceStartError:
    return ServiceStartError(
        what, remedy=f"the end of its log {log}:\n{log_end(log)}\nthen `make down` and start again"
    )


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
