"""The parent's side of a child: calls with a deadline, and an end for a process that does not keep it."""

import time
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import asdict, dataclass
from threading import Lock
from typing import Any

from cspace.errors import CspaceError
from inference_api.models.apart.processes.limits import MEMORY_BYTES
from inference_api.models.apart.processes.pipes import ChildError
from inference_api.models.apart.processes.process import ChildProcess
from inference_api.models.apart.processes.serving import IDLE_STATUS, READY
from inference_api.models.apart.processes.wire import error_of, from_line, to_line

# Between two starts of a process that fails again and again.
FIRST_PAUSE_S, LONGEST_PAUSE_S = 1.0, 30.0
_CLOSE_S = 2.0


@dataclass(frozen=True, slots=True)
class ChildLimits:
    """What a child may take.

    Args:
        start_s: until it is ready; imports on a busy machine take their time.
        idle_s: without work, after which it leaves by itself; None for never.
        memory_bytes: address space beyond its libraries.
        is_patient: whether another process follows at once on one that was late or died at work, and not
            after a pause; for work whose failures are not the next one's.
    """

    start_s: float = 60.0
    idle_s: float | None = 30.0
    memory_bytes: int = MEMORY_BYTES
    is_patient: bool = True


class Child:
    """A process that is started when it is needed and ended when it is late; safe to share between threads.

    Args:
        role: of :data:`inference_api.models.apart.processes.serving.ROLES`.
        configuration: for the role.
        limits: for the process.
    """

    def __init__(
        self, role: str, configuration: Mapping[str, Any], limits: ChildLimits | None = None
    ) -> None:
        self._role, self._limits = role, limits or ChildLimits()
        self._configuration = {**configuration, **asdict(self._limits)}
        # The turn is held for a whole call; the state only for as long as it is looked at or changed.
        self._turn, self._state = Lock(), Lock()
        self._process: ChildProcess | None = None
        self._is_closed = False
        self._pause_s, self._resting_until_s = FIRST_PAUSE_S, 0.0
        self._calls = 0

    @property
    def pid(self) -> int | None:
        """Of the process that there is, None without one."""
        process = self._process
        return None if process is None else process.pid

    def start(self) -> None:
        """Start the process if there is none, without waiting for it; what fails is told by the next call."""
        with self._state, suppress(ChildError):
            self._is_closed = False
            if self._process is None:
                self._process = ChildProcess(self._role, self._configuration)

    def close(self) -> None:
        """End the process; a call that waits for it fails at once, as do later ones."""
        with self._state:
            self._is_closed = True
            if self._process is not None:
                self._process.kill()
        if self._turn.acquire(timeout=_CLOSE_S):
            self._clear()
            self._turn.release()

    def tend(self) -> None:
        """Clear away a process that has left by itself; to be called now and then."""
        if self._turn.acquire(blocking=False):
            try:
                process = self._process
                if process is not None and process.has_ended:
                    self._clear()
            finally:
                self._turn.release()

    def call(self, job: str, arguments: Mapping[str, Any], limit_s: float) -> Any:
        """The result of a job.

        Args:
            job: of the role.
            arguments: of JSON.
            limit_s: for the turn, and again for the job; the start of a process comes on top.

        Raises:
            ChildError: there is no result in time.
            CspaceError: what the job raises.
        """
        if not self._turn.acquire(timeout=limit_s):
            raise ChildError("it is busy", at_work=False)
        try:
            reply = self._converse(job, arguments, limit_s)
        except ChildError as error:
            had_process = self._process is not None
            self._clear()
            if had_process and not (error.at_work and self._limits.is_patient):
                self._resting_until_s = time.monotonic() + self._pause_s
                self._pause_s = min(2.0 * self._pause_s, LONGEST_PAUSE_S)
            raise
        finally:
            self._turn.release()
        self._pause_s = FIRST_PAUSE_S
        if isinstance(reply, CspaceError):
            raise reply
        return reply

    def _converse(self, job: str, arguments: Mapping[str, Any], limit_s: float) -> Any:
        self._calls += 1
        request = {"id": self._calls, "job": job, "arguments": dict(arguments), "limit_s": limit_s}
        process = self._running()
        try:
            return self._exchange(process, request, limit_s)
        except ChildError:
            # It may leave by itself in the very moment in which there is work again.
            if not process.has_ended or process.exit_status() != IDLE_STATUS:
                raise
        self._clear()
        return self._exchange(self._running(), request, limit_s)

    def _exchange(self, process: ChildProcess, request: Mapping[str, Any], limit_s: float) -> Any:
        until_s = time.monotonic() + limit_s
        process.send(to_line(request), until_s)
        reply = _parsed(process.receive(until_s))
        if set(reply) == {"id", "result"} and reply["id"] == request["id"]:
            return reply["result"]
        if set(reply) == {"id", "error"} and reply["id"] == request["id"]:
            return _parsed_error(reply["error"])
        raise _rubbish()

    def _running(self) -> ChildProcess:
        if self._process is not None and self._process.has_ended:
            self._clear()
        with self._state:
            if self._is_closed:
                raise ChildError("the server is shutting down", at_work=False)
            if self._process is None:
                if time.monotonic() < self._resting_until_s:
                    raise ChildError("it has failed a moment ago", at_work=False)
                self._process = ChildProcess(self._role, self._configuration)
            process = self._process
        if not process.is_ready:
            try:
                line = process.receive(time.monotonic() + self._limits.start_s)
            except ChildError as error:
                raise ChildError(f"it does not start: {error}", at_work=False) from None
            if line != to_line(READY):
                raise ChildError("it does not start", at_work=False)
            process.is_ready = True
        return process

    def _clear(self) -> None:
        """By whoever has the turn."""
        with self._state:
            process, self._process = self._process, None
            if process is not None:
                process.clear()


def _parsed(line: bytes) -> dict[str, Any]:
    try:
        return from_line(line)
    except ValueError:
        raise _rubbish() from None


def _parsed_error(values: object) -> CspaceError:
    try:
        return error_of(values)
    except ValueError:
        raise _rubbish() from None


def _rubbish() -> ChildError:
    return ChildError("it answers what is no answer", at_work=True)
