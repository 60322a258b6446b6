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
from functools import partial
from typing import Annotated, Any, get_args

from fastapi import Depends, FastAPI, Request
from prometheus_client import CollectorRegistry, Counter, Gauge, Histogram, Summary, generate_latest
from prometheus_client.process_collector import ProcessCollector
from starlette.datastructures import Headers, MutableHeaders
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from cspace.errors import ConfigError
from cspace.query import Status
from inference_api.limits import HEALTH, METRICS
from inference_api.problems import PROBLEMS, SHUTTING_DOWN, RequestError, problem_response
from inference_api.served_models import Reload, ServedModel
from services.outcomes import RESULTS

CONTENT_TYPE = "text/plain; version=0.0.4; charset=utf-8"
REQUEST_ID = "X-Request-ID"
METHODS = frozenset({"GET", "HEAD", "POST", "PUT", "PATCH", "DELETE", "OPTIONS", "TRACE", "CONNECT"})
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


class Metrics:
    """Counts and times what one app does; safe to share between threads."""

    def __init__(self) -> None:
        self._registry = registry = CollectorRegistry()
        counter, gauge = partial(Counter, registry=registry), partial(Gauge, registry=registry)
        self.requests = counter(
            "cspace_requests", "Requests answered, by template of the route.", ("route", "method", "status")
        )
        self.failures = counter("cspace_failures", "Answers that were problems, by type.", ("reason",))
        self.in_flight = gauge("cspace_requests_in_flight", "Requests being answered.")
        self.waiting = gauge("cspace_requests_waiting", "Requests that wait for a place to compute.")
        self.stages = Histogram(
            "cspace_stage_seconds",
            "Time in each stage of samples.",
            ("stage",),
            buckets=_STAGE_BUCKETS_S,
            registry=registry,
        )
        self.acceptance = Summary(
            "cspace_acceptance_ratio", "Share of proposals that reached the confidence.", registry=registry
        )
        self.plans = counter("cspace_plans", "Answers of POST /plan, by status.", ("status",))
        self.reloads = counter("cspace_model_reloads", "Champions served, refused or removed.", ("outcome",))
        self.outcomes = counter("cspace_outcomes", "Outcomes written to disk, or lost.", ("result",))
        self._model = gauge(
            "cspace_model_info",
            "The model that answers requests that name none.",
            ("name", "version", "digest", "fallback"),
        )
        ProcessCollector(registry=registry)
        # Else a rate over the first event of a kind would see no rise.
        for metric, values in (
            (self.failures, [problem.name for problem in PROBLEMS]),
            (self.plans, get_args(Status)),
            (self.reloads, get_args(Reload)),
            (self.outcomes, RESULTS),
        ):
            for value in values:
                metric.labels(value)

    def render(self, model: ServedModel | None) -> bytes:
        """All metrics in Prometheus' text format; ``model`` is the one that answers by default."""
        self._model.clear()
        if model is not None:
            fallback = str(model.fallback).lower()
            self._model.labels(model.name, model.version, model.bundle.digest, fallback).set(1)
        return generate_latest(self._registry)


class Telemetry:
    """ASGI middleware round all others: id, security headers, metrics and log line of every request.

    An error that nobody foresaw is answered with 500 here, inside of these, and a request that is cancelled
    at the server's end with 503.
    """

    def __init__(self, app: ASGIApp, metrics: Metrics) -> None:
        self._app, self._metrics = app, metrics

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Passes a request on."""
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
            with self._metrics.in_flight.track_inprogress():
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
        method = scope["method"] if scope["method"] in METHODS else "other"
        self._metrics.requests.labels(route, method, str(status)).inc()
        # Nothing in it is free text of the client's.
        fields = request_fields.get() | {"method": method, "route": route, "status": status}
        fields["duration_ms"] = round(duration_ms, 3)
        if (reason := scope["state"].get("problem")) is not None:
            self._metrics.failures.labels(reason).inc()
            fields["reason"] = reason
        _ACCESS_LOG.info("%s %s %s", method, route, status, extra={"fields": fields})


_SHUT_DOWN = RequestError(
    SHUTTING_DOWN,
    "the server was told to end before this request was answered",
    remedy="ask again: another process may answer by then",
    headers={"Connection": "close", "Retry-After": "1"},
)


class JsonFormatter(logging.Formatter):
    """A line is an object of JSON; inside a request it has the request's id."""

    def format(self, record: logging.LogRecord) -> str:
        """The line."""
        request_id = request_fields.get({}).get("request_id")
        line = {
            "time": datetime.fromtimestamp(record.created, UTC).isoformat(timespec="milliseconds"),
            "level": record.levelname.lower(),
            "logger": record.name,
            "message": record.getMessage(),
            **({} if request_id is None else {"request_id": request_id}),
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
    try:
        from opentelemetry.exporter.otlp.proto.http.trace_exporter import OTLPSpanExporter  # noqa: PLC0415
        from opentelemetry.instrumentation.fastapi import FastAPIInstrumentor  # noqa: PLC0415
        from opentelemetry.sdk.trace import TracerProvider  # noqa: PLC0415
        from opentelemetry.sdk.trace.export import BatchSpanProcessor  # noqa: PLC0415
    except ModuleNotFoundError as error:
        raise ConfigError(
            "traces cannot be sent",
            expected="the packages of the extra tracing",
            got=str(error),
            remedy="pip install 'cspace-sampler[tracing]', or unset OTEL_EXPORTER_OTLP_ENDPOINT",
        ) from error
    os.environ.setdefault("OTEL_SERVICE_NAME", "cspace-sampler-api")
    # At the interpreter's exit it sends what is still waiting.
    provider = TracerProvider()
    provider.add_span_processor(BatchSpanProcessor(OTLPSpanExporter()))
    FastAPIInstrumentor.instrument_app(
        app,
        tracer_provider=provider,
        excluded_urls=",".join(f"{path}$" for path in (*HEALTH, METRICS)),
        exclude_spans=["receive", "send"],
    )


async def _metrics_of(request: Request) -> Metrics:
    metrics: Metrics = request.app.state.metrics
    return metrics


# What routes take.
Metered = Annotated[Metrics, Depends(_metrics_of)]
