"""Processes that outlive the command that starts them: started detached, known and ended by process id.

Every process carries a marker in its environment, which all that it starts inherit. What is left over after
its root was killed is found by that marker and by the ids that were recorded, never by a name.
"""

import os
import subprocess
import uuid
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from pathlib import Path

import psutil

from cspace.errors import ServiceStartError
from services.local.servers.records import ProcessId, Record

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
