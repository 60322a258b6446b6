"""Log lines, and the record of the request that is being answered: gathered on the way, told at its end.

A context variable holds the record, so that whoever learns something writes it down in one line, threads that
a request hands its work to included. This module is light: the command imports it before anything else.
"""

import json
import logging
import re
import secrets
from contextvars import ContextVar
from dataclasses import dataclass
from datetime import UTC, datetime
from typing import Any, Literal

# The attribute of a log record that holds its fields.
FIELDS = "cspace_fields"
LogForm = Literal["text", "json"]
LOG_FORMS: tuple[LogForm, ...] = ("text", "json")
_ACCESS_LOG = logging.getLogger("inference_api.access")
REQUEST_ID = re.compile(r"[A-Za-z0-9._-]{1,128}", re.ASCII)


@dataclass(slots=True)
class RequestRecord:
    """One request.

    Args:
        request_id: the client's, or one of the server's.
        path: that is asked for.
        client: name of the key that it came with.
        reason: name of the problem that was its answer.
        model: that answered, ``name/version``.
        n: samples asked for.
        seed: that was used.
        shortfall: samples that are missing.
    """

    request_id: str
    path: str = ""
    client: str | None = None
    reason: str | None = None
    model: str | None = None
    n: int | None = None
    seed: int | None = None
    shortfall: int | None = None


# The record of the request that is being answered; None outside of one.
request_record: ContextVar[RequestRecord | None] = ContextVar("request_record", default=None)


def choose_request_id(sent: str | None) -> str:
    """The client's id if it is 1 to 128 of ``A-Za-z0-9._-``, else a fresh one of 32 hexadecimal digits."""
    return sent if sent is not None and REQUEST_ID.fullmatch(sent) else secrets.token_hex(16)


def log_request(record: RequestRecord, method: str, route: str, status: int, duration_s: float) -> None:
    """Writes the line of a request that was answered; nothing in it is free text of the client's."""
    fields = {
        "request_id": record.request_id,
        "client": record.client,
        "method": method,
        "route": route,
        "status": status,
        "duration_ms": round(1e3 * duration_s, 3),
        "reason": record.reason,
        "model": record.model,
        "n": record.n,
        # JSON's numbers end at 53 bits.
        "seed": None if record.seed is None else str(record.seed),
        "shortfall": record.shortfall,
    }
    known = {name: value for name, value in fields.items() if value is not None}
    _ACCESS_LOG.info("%s %s %d", method, route, status, extra={FIELDS: known})


def _fields_of(record: logging.LogRecord) -> dict[str, Any]:
    """The fields of a line; a line inside a request has at least its id."""
    fields: dict[str, Any] = dict(getattr(record, FIELDS, {}))
    request = request_record.get()
    if request is not None:
        fields.setdefault("request_id", request.request_id)
    return fields


class JsonFormatter(logging.Formatter):
    """``time`` (UTC), ``level``, ``logger``, ``message``, the fields, ``exception`` where there is one."""

    def format(self, record: logging.LogRecord) -> str:
        """The line."""
        line = {
            "time": datetime.fromtimestamp(record.created, UTC).isoformat(timespec="milliseconds"),
            "level": record.levelname.lower(),
            "logger": record.name,
            "message": record.getMessage(),
            **_fields_of(record),
        }
        if record.exc_info:
            line["exception"] = self.formatException(record.exc_info)
        return json.dumps(line, default=str)


class TextFormatter(logging.Formatter):
    """``LEVEL:     message name=value ...``."""

    def __init__(self) -> None:
        super().__init__("%(levelname)s:     %(message)s%(cspace_tail)s")

    def format(self, record: logging.LogRecord) -> str:
        """The line."""
        skipped = ("method", "route", "status")
        pairs = (f" {name}={value}" for name, value in _fields_of(record).items() if name not in skipped)
        record.cspace_tail = "".join(pairs)
        return super().format(record)


def log_settings(form: LogForm) -> dict[str, Any]:
    """Settings for :func:`logging.config.dictConfig`: all to standard error, the project's own from INFO on.

    The server hands them to each of its processes.
    """
    formatter = JsonFormatter if form == "json" else TextFormatter
    return {
        "version": 1,
        "disable_existing_loggers": False,
        "formatters": {"line": {"()": f"{formatter.__module__}.{formatter.__qualname__}"}},
        "handlers": {"standard-error": {"class": "logging.StreamHandler", "formatter": "line"}},
        "root": {"level": "WARNING", "handlers": ["standard-error"]},
        "loggers": {
            "inference_api": {"level": "INFO"},
            # What is no HTTP has its line as a request, without a warning of uvicorn's beside it.
            "inference_api.server.protocol": {"level": "ERROR"},
            "uvicorn": {"level": "INFO"},
            # What the parser thinks of a client's bytes is told to the client.
            "python_multipart": {"level": "ERROR"},
        },
    }
