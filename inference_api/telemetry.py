"""What is known of requests afterwards: Prometheus metrics, log lines, and OpenTelemetry's traces.

Every label of a metric has a bounded set of values: templates of routes, problem types, the methods of HTTP,
statuses that the server itself chooses, one model.
"""

import asyncio
import json
import logging
import os
import re
import secrets
import time
from contextvars import ContextVar
from datetime import UTC, datetime
from http import HTTPMethod
from typing import Any, get_args

from fastapi import FastAPI
from prometheus_client import Counter, Gauge, Histogram, Summary, generate_latest
from starlette.datastructures import Headers, MutableHeaders
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from cspace.query import Status
from inference_api.problems import PROBLEMS, SHUTTING_DOWN, RequestError, problem_response
from inference_api.served_models import Reload, ServedModel
from services.outcomes import RESULTS

REQUEST_ID = "X-Request-ID"
# After OWASP's REST Security Cheat Sheet. A page that needs more, /docs, brings a policy of its own.
SECURITY_HEADERS = {
    "Cache-Control": "no-store",
    "Content-Security-Policy": "default-src 'none'; frame-ancestors 'none'",
    "Cross-Origin-Resource-Policy": "same-origin",
    "Referrer-Policy": "no-referrer",
    "X-Content-Type-Options": "nosniff",
}
_SENT_ID = re.compile(r"[A-Za-z0-9._-]{1,128}", re.ASCII)
# From a picture that is known and a small network to a large n on a busy processor, in s.
_STAGE_BUCKETS_S = (0.0005, 0.001, 0.0025, 0.005, 0.01, 0.025, 0.05, 0.1, 0.25, 0.5, 1.0, 2.5, 5.0, 10.0)
_ACCESS_LOG = logging.getLogger("inference_api.access")
# What the log says of the request that is being answered, in its threads, too.
request_fields: ContextVar[dict[str, Any]] = ContextVar("request_fields")


REQUESTS = Counter(
    "cspace_requests", "Requests answered, by template of the route.", ("route", "method", "status")
)
FAILURES = Counter("cspace_failures", "Answers that were problems, by type.", ("reason",))
IN_FLIGHT = Gauge("cspace_requests_in_flight", "Requests being answered.")
STAGES = Histogram(
    "cspace_stage_seconds", "Time in each stage of samples.", ("stage",), buckets=_STAGE_BUCKETS_S
)
ACCEPTANCE = Summary("cspace_acceptance_ratio", "Share of proposals that reached the confidence.")
PLANS = Counter("cspace_plans", "Answers of POST /plan, by status.", ("status",))
RELOADS = Counter("cspace_model_reloads", "Champions served, refused or removed.", ("outcome",))
OUTCOMES = Counter("cspace_outcomes", "Outcomes written to disk, or lost.", ("result",))
MODEL = Gauge(
    "cspace_model_info",
    "The model that answers requests that name none.",
    ("name", "version", "digest", "fallback"),
)
# Else a rate over the first event of a kind would see no rise.
for metric, values in (
    (FAILURES, [problem.name for problem in PROBLEMS]),
    (PLANS, get_args(Status)),
    (RELOADS, get_args(Reload)),
    (OUTCOMES, RESULTS),
):
    for value in values:
        metric.labels(value)


def metrics_text(model: ServedModel | None) -> bytes:
    """All metrics in Prometheus' text format; ``model`` is the one that answers by default."""
    MODEL.clear()
    if model is not None:
        fallback = str(model.fallback).lower()
        MODEL.labels(model.name, model.version, model.bundle.digest, fallback).set(1)
    return generate_latest()


class Telemetry:
    """ASGI middleware round all others: id, security headers, metrics and log line of every request.

    An error that nobody foresaw is answered with 500 here, inside of these, and a request that is cancelled
    at the server's end with 503.
    """

    def __init__(self, app: ASGIApp) -> None:
        self._app = app

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        if scope["type"] != "http":
            await self._app(scope, receive, send)
            return
        sent = Headers(scope=scope).get(REQUEST_ID, "")
        request_id = sent if _SENT_ID.fullmatch(sent) else secrets.token_hex(16)
        scope.setdefault("state", {})["request_id"] = request_id
        token = request_fields.set({"request_id": request_id})
        began, status = time.perf_counter(), 0

        async def labelled(message: Message) -> None:
            nonlocal status
            if message["type"] == "http.response.start":
                status = message["status"]
                headers = MutableHeaders(scope=message)
                for name, value in SECURITY_HEADERS.items():
                    headers.setdefault(name, value)
                headers[REQUEST_ID] = request_id
            await send(message)

        try:
            with IN_FLIGHT.track_inprogress():
                await self._app(scope, receive, labelled)
        except asyncio.CancelledError:
            if not status:
                await problem_response(_SHUT_DOWN)(scope, receive, labelled)
            raise
        except Exception as error:
            if status:
                raise
            await problem_response(error)(scope, receive, labelled)
        finally:
            self._finish(scope, status, 1e3 * (time.perf_counter() - began))
            request_fields.reset(token)

    def _finish(self, scope: Scope, status: int, duration_ms: float) -> None:
        # Of mounted files it is the folder.
        route = getattr(scope.get("route"), "path", scope.get("root_path")) or "unknown"
        method = scope["method"] if scope["method"] in HTTPMethod.__members__ else "other"
        REQUESTS.labels(route, method, str(status)).inc()
        # Nothing in it is free text of the client's.
        fields = {"method": method, "route": route, "status": status, "duration_ms": round(duration_ms, 3)}
        if (reason := scope["state"].get("problem")) is not None:
            FAILURES.labels(reason).inc()
            fields["reason"] = reason
        _ACCESS_LOG.info("%s %s %s", method, route, status, extra={"fields": fields})


_SHUT_DOWN = RequestError(
    SHUTTING_DOWN,
    "the server was told to end before this request was answered",
    remedy="ask again: another process may answer by then",
    headers={"Connection": "close", "Retry-After": "1"},
)


class JsonFormatter(logging.Formatter):
    """A line is an object of JSON; inside a request with what is known of it."""

    def format(self, record: logging.LogRecord) -> str:
        line = {
            "time": datetime.fromtimestamp(record.created, UTC).isoformat(timespec="milliseconds"),
            "level": record.levelname.lower(),
            "logger": record.name,
            "message": record.getMessage(),
            **request_fields.get({}),
            **getattr(record, "fields", {}),
        }
        if record.exc_info:
            line["exception"] = self.formatException(record.exc_info)
        return json.dumps(line, default=str)


def configure_logging() -> None:
    """All warnings go to standard error, the project's own lines from INFO on."""
    handler = logging.StreamHandler()
    handler.setFormatter(JsonFormatter())
    logging.basicConfig(level=logging.WARNING, handlers=[handler])
    for name in ("inference_api", "uvicorn"):
        logging.getLogger(name).setLevel(logging.INFO)
    # The parser's lines quote clients, those of MLflow and urllib3 name the registry's address.
    for name in ("python_multipart", "mlflow", "urllib3"):
        logging.getLogger(name).setLevel(logging.ERROR)


def add_tracing(app: FastAPI) -> None:
    """Sends a span for every request but those that only watch, by OpenTelemetry's own variables."""
    # Of the extra tracing.
    from opentelemetry.exporter.otlp.proto.http.trace_exporter import OTLPSpanExporter  # noqa: PLC0415
    from opentelemetry.instrumentation.fastapi import FastAPIInstrumentor  # noqa: PLC0415
    from opentelemetry.sdk.trace import TracerProvider  # noqa: PLC0415
    from opentelemetry.sdk.trace.export import BatchSpanProcessor  # noqa: PLC0415

    os.environ.setdefault("OTEL_SERVICE_NAME", "cspace-sampler-api")
    # At the interpreter's exit it sends what is still waiting.
    provider = TracerProvider()
    provider.add_span_processor(BatchSpanProcessor(OTLPSpanExporter()))
    FastAPIInstrumentor.instrument_app(
        app, tracer_provider=provider, excluded_urls="/health/,/metrics$", exclude_spans=["receive", "send"]
    )
