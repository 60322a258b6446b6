"""Whether services answer, and waiting until they do."""

import http.client
import json
import time
import urllib.error
import urllib.request
from collections.abc import Callable, Mapping
from contextlib import suppress
from pathlib import Path

from cspace.errors import ServiceStartError

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
