"""One child process and its pipes: started, and ended for good."""

import os
import signal
import subprocess
import sys
import time
from collections.abc import Mapping
from contextlib import suppress
from typing import Any

from inference_api.models.apart.processes.pipes import ChildError, receive, send
from inference_api.models.apart.processes.wire import to_line
from services.names import ARTIFACT_STORE

_CONFIGURED_S = 1.0
_EXIT_S = 1.0


class ChildProcess:
    """A process in a session of its own, that nobody but its parent talks to.

    Args:
        role: of :data:`inference_api.models.apart.processes.serving.ROLES`.
        configuration: its first line.

    Raises:
        ChildError: there can be no process.
    """

    def __init__(self, role: str, configuration: Mapping[str, Any]) -> None:
        try:
            self._popen = subprocess.Popen(
                [sys.executable, "-m", "inference_api.models.apart", role],
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                # Its libraries write the registry's address there.
                stderr=subprocess.DEVNULL,
                env=_environment(),
                # For a signal to all of it. Not a session of its own: the kernel shares cores out among
                # sessions, and beside a busy server on one core such a child got no time at all.
                process_group=0,
            )
        except OSError as error:
            raise ChildError(f"no process can be started: {error.strerror}", at_work=False) from None
        self._input, self._output = _descriptor(self._popen.stdin), _descriptor(self._popen.stdout)
        self.is_ready = False
        self.send(to_line(configuration), time.monotonic() + _CONFIGURED_S)

    @property
    def pid(self) -> int:
        """Its number, of its group as well."""
        return self._popen.pid

    @property
    def has_ended(self) -> bool:
        """Whether it runs no more."""
        return self._popen.poll() is not None

    def exit_status(self) -> int | None:
        """The status of a process whose pipes are closed, None if it runs on."""
        with suppress(subprocess.TimeoutExpired):
            return self._popen.wait(_EXIT_S)
        return None

    def send(self, line: bytes, until_s: float) -> None:
        """As :func:`inference_api.models.apart.processes.pipes.send`."""
        send(self._input, line, until_s)

    def receive(self, until_s: float) -> bytes:
        """As :func:`inference_api.models.apart.processes.pipes.receive`."""
        return receive(self._output, until_s)

    def kill(self) -> None:
        """End it and what it has started; its pipes stay open for whoever waits at them."""
        # Its number cannot be another's before it is waited for.
        if self._popen.returncode is None:
            with suppress(ProcessLookupError):
                os.killpg(self._popen.pid, signal.SIGKILL)

    def clear(self) -> None:
        """End it and leave nothing of it; nobody may wait at its pipes any more."""
        self.kill()
        self._popen.wait()
        for stream in (self._popen.stdin, self._popen.stdout):
            if stream is not None:
                with suppress(OSError):
                    stream.close()


def _descriptor(stream: Any) -> int:
    descriptor: int = stream.fileno()
    os.set_blocking(descriptor, False)
    return descriptor


def _environment() -> dict[str, str]:
    """The parent's, without what is the API's alone, and with the same modules in reach from every folder."""
    kept = {
        name: value
        for name, value in os.environ.items()
        if not name.startswith("CSPACE_") or name == ARTIFACT_STORE
    }
    places = os.pathsep.join(place for place in sys.path if place)
    return {**kept, "PYTHONPATH": places, "PYTHONSAFEPATH": "1"}
