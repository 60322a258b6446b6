"""A child's side: one job after the other, from lines on standard input to lines on standard output."""

import os
import queue
import sys
from collections.abc import Callable, Mapping
from importlib import import_module
from threading import Thread
from typing import Any, NoReturn

from cspace.errors import CspaceError, StorageError
from inference_api.memory import few_arenas
from inference_api.models.apart.processes.limits import limit_resources, limit_time, own_signals
from inference_api.models.apart.processes.wire import MAX_LINE_BYTES, error_values, from_line, to_line

Jobs = Mapping[str, Callable[..., Any]]
# By role: the module whose ``jobs(configuration)`` makes them; what it imports is imported before the limits.
ROLES = {
    "lookups": "inference_api.models.apart.lookups_jobs",
    "loading": "inference_api.models.apart.loading_jobs",
}
READY = {"ready": True}
# Nothing was to be done for so long that the child has left by itself.
IDLE_STATUS = 0
FAILED_STATUS = 3


def serve(role: str) -> NoReturn:
    """Serve until the parent is gone or there is nothing to do."""
    own_signals()
    few_arenas()
    # What a library prints must not get between the replies.
    replies = os.dup(sys.stdout.fileno())
    os.dup2(sys.stderr.fileno(), sys.stdout.fileno())
    lines: queue.SimpleQueue[bytes] = queue.SimpleQueue()
    Thread(target=_read, args=(lines,), daemon=True).start()
    configuration = from_line(lines.get())
    limit_time(configuration["start_s"])
    jobs = import_module(ROLES[role]).jobs(configuration)
    limit_resources(configuration["memory_bytes"])
    limit_time(0.0)
    _write(replies, READY)
    while True:
        try:
            line = lines.get(timeout=configuration["idle_s"])
        except queue.Empty:
            os._exit(IDLE_STATUS)
        request = from_line(line)
        limit_time(request["limit_s"])
        reply = _reply(jobs, request)
        limit_time(0.0)
        _write(replies, {"id": request["id"], **reply})


def _reply(jobs: Jobs, request: Mapping[str, Any]) -> dict[str, Any]:
    try:
        return {"result": jobs[request["job"]](**request["arguments"])}
    except CspaceError as error:
        return {"error": error_values(error)}
    except OSError as error:
        full = StorageError("a file cannot be read or written", got=error.strerror)
        return {"error": error_values(full)}


def _read(lines: "queue.SimpleQueue[bytes]") -> None:
    """Runs beside the jobs, so that the end of the parent ends this process in the middle of one."""
    while line := sys.stdin.buffer.readline(MAX_LINE_BYTES):
        lines.put(line)
    os._exit(FAILED_STATUS)


def _write(descriptor: int, message: Mapping[str, Any]) -> None:
    rest = memoryview(to_line(message))
    while rest:
        rest = rest[os.write(descriptor, rest) :]
