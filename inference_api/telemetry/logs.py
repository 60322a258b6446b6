"""Log lines as text or as JSON, one object a line, both with the id of the request that they belong to."""

import json
import logging
from datetime import UTC, datetime
from typing import Any, Literal

from inference_api.record import current

# The attribute of a log record that holds its fields.
FIELDS = "cspace_fields"
LogForm = Literal["text", "json"]
LOG_FORMS: tuple[LogForm, ...] = ("text", "json")


def fields_of(record: logging.LogRecord) -> dict[str, Any]:
    """The fields of a line; a line inside a request has at least its id."""
    fields: dict[str, Any] = dict(getattr(record, FIELDS, {}))
    request = current()
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
            **fields_of(record),
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
        pairs = (f" {name}={value}" for name, value in fields_of(record).items() if name not in skipped)
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
        # What the form's parser thinks of a client's bytes is told to the client.
        "loggers": {
            "inference_api": {"level": "INFO"},
            "uvicorn": {"level": "INFO"},
            "python_multipart": {"level": "ERROR"},
        },
    }
