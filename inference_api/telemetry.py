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
from collections.abc import Callable, Iterator
from contextvars import ContextVar
from dataclasses import dataclass, field
from datetime import UTC, datetime
from functools import partial
from typing import TYPE_CHECKING, Annotated, Any, Literal, get_args

from fastapi import Depends, FastAPI, Request
from prometheus_client import CollectorRegistry, Counter, Gauge, Histogram, generate_latest
from prometheus_client.core import GaugeMetricFamily, Metric
from prometheus_client.process_collector import ProcessCollector
from prometheus_client.registry import Collector
from starlette.datastructures import Headers
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from cspace.errors import ConfigError
from cspace.query import Status
from inference_api.limits import HEALTH, METRICS
from inference_api.models import Reload, ServedModel
from inference_api.problems import PROBLEMS, SHUTTING_DOWN, RequestError, problem_response
from inference_api.settings import TRACES_ENDPOINTS
from services.outcomes import RESULTS

if TYPE_CHECKING:
    from opentelemetry.sdk.trace import TracerProvider

CONTENT_TYPE = "text/plain; version=0.0.4; charset=utf-8"
REQUEST_ID = "X-Request-ID"
STAGES = ("decode", "encode", "generate", "total")
METHODS = frozenset({"GET", "HEAD", "POST", "PUT", "PATCH", "DELETE", "OPTIONS", "TRACE", "CONNECT"})
# After OWASP's REST Security Cheat Sheet. A page that needs more, /docs, brings a policy of its own.
SECURITY_HEADERS = {
    "Cache-Control": "no-store",
    "Content-Security-Policy": "default-src 'none'; frame-ancestors 'none'",
    "Cross-Origin-Resource-Policy": "same-origin",
    "Referrer-Policy": "no-referrer",
    "X-Content-Type-Options": "nosniff",
}
_RAW_SECURITY_HEADERS = [(name.lower().encode(), value.encode()) for name, value in SECURITY_HEADERS.items()]
LOG_FORMS: tuple[str, ...] = ("text", "json")
_SENT_ID = re.compile(r"[A-Za-z0-9._-]{1,128}", re.ASCII)
# From a picture that is known and a small network to a large n on a busy processor, in s.
_STAGE_BUCKETS_S = (0.0005, 0.001, 0.0025, 0.005, 0.01, 0.025, 0.05, 0.1, 0.25, 0.5, 1.0, 2.5, 5.0, 10.0)
_ACCEPTANCE_BUCKETS = (0.05, 0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8, 0.9, 0.95, 1.0)
_LOG, _ACCESS_LOG = logging.getLogger(__name__), logging.getLogger("inference_api.access")


@dataclass(slots=True)
class RequestRecord:
    """What the log says of one request; ``client`` is the name of the key that it came with."""

    request_id: str
    client: str | None = None
    method: str | None = None
    route: str | None = None
    status: int | None = None
    duration_ms: float | None = None
    reason: str | None = None
    model: str | None = None
    n: int | None = None
    seed: str | None = None
    shortfall: int | None = None


# The record of the request that is being answered, in its threads, too; None outside of one.
request_record: ContextVar[RequestRecord | None] = ContextVar("request_record", default=None)


@dataclass(frozen=True, slots=True)
class Answered:
    """What a model answered.

    Args:
        kind: of answer.
        served: the model that answered.
        n: samples that were asked for, or configurations that were scored.
        seed: that was used.
        shortfall: samples that are missing.
        acceptance: share of what was drawn that reached the confidence asked for, 0 to 1.
        status: of a plan.
        stages_s: time by stage of :data:`STAGES`, s.
    """

    kind: Literal["samples", "scores", "plan", "diagnosis", "belief"]
    served: ServedModel
    n: int | None = None
    seed: int | None = None
    shortfall: int | None = None
    acceptance: float | None = None
    status: str | None = None
    stages_s: dict[str, float] = field(default_factory=dict)


class Metrics:
    """Counts and times what one app does; safe to share between threads.

    Args:
        model: the model that answers by default, None without one; asked at each scrape.
    """

    def __init__(self, model: Callable[[], ServedModel | None]) -> None:
        self._registry = registry = CollectorRegistry()
        counter, histogram = partial(Counter, registry=registry), partial(Histogram, registry=registry)
        gauge = partial(Gauge, registry=registry)
        self.requests = counter(
            "cspace_requests", "Requests answered, by template of the route.", ("route", "method", "status")
        )
        self.failures = counter("cspace_failures", "Answers that were problems, by type.", ("reason",))
        self.in_flight = gauge("cspace_requests_in_flight", "Requests being answered.")
        self.waiting = gauge("cspace_requests_waiting", "Requests that wait for a place to compute.")
        self._stages = histogram(
            "cspace_stage_seconds", "Time in each stage of samples.", ("stage",), buckets=_STAGE_BUCKETS_S
        )
        self._acceptance = histogram(
            "cspace_acceptance_ratio",
            "Share of what was drawn that reached the confidence asked for, by answer.",
            buckets=_ACCEPTANCE_BUCKETS,
        )
        self._requested = counter("cspace_samples_requested", "Samples asked for.")
        self._returned = counter("cspace_samples_returned", "Samples returned.")
        self._scored = counter("cspace_configurations_scored", "Configurations scored by POST /validity.")
        self._plans = counter("cspace_plans", "Answers of POST /plan, by status.", ("status",))
        self._fallbacks = counter("cspace_fallback_answers", "Answers of a shipped model in another's stead.")
        self._reloads = counter("cspace_model_reloads", "Champions served, refused or removed.", ("outcome",))
        self._outcomes = counter("cspace_outcomes", "Outcomes written to disk, or lost.", ("result",))
        # Else a rate over the first event of a kind would see no rise.
        for problem in PROBLEMS:
            self.failures.labels(problem.name)
        for status in get_args(Status):
            self._plans.labels(status)
        for result in RESULTS:
            self._outcomes.labels(result)
        for reload in get_args(Reload):
            self._reloads.labels(reload)
        ProcessCollector(registry=registry)
        registry.register(_ModelCollector(model))

    def answered(self, answer: Answered) -> None:
        """Counts an answer, and writes it down for the request's line in the log."""
        if answer.served.fallback:
            self._fallbacks.inc()
        if answer.kind == "samples":
            for stage, seconds in answer.stages_s.items():
                self._stages.labels(stage).observe(seconds)
            self._acceptance.observe(answer.acceptance or 0.0)
            self._requested.inc(answer.n or 0)
            self._returned.inc((answer.n or 0) - (answer.shortfall or 0))
        elif answer.kind == "scores":
            self._scored.inc(answer.n or 0)
        elif answer.kind == "plan":
            self._plans.labels(answer.status).inc()
        record = request_record.get()
        if record is not None:
            record.model, record.n, record.shortfall = str(answer.served), answer.n, answer.shortfall
            # JSON's numbers end at 53 bits.
            record.seed = None if answer.seed is None else str(answer.seed)

    def reloaded(self, reload: Reload) -> None:
        """Counts a champion that was put into service, refused, or removed."""
        self._reloads.labels(reload).inc()

    def outcomes(self, result: str, count: int) -> None:
        """Counts outcomes that were written, or are lost."""
        self._outcomes.labels(result).inc(count)

    def render(self) -> bytes:
        """All metrics in Prometheus' text format."""
        return generate_latest(self._registry)


class _ModelCollector(Collector):
    """One series with the value 1: the model in service now, however it came there."""

    def __init__(self, model: Callable[[], ServedModel | None]) -> None:
        self._model = model

    def describe(self) -> Iterator[Metric]:
        yield self._family()

    def collect(self) -> Iterator[Metric]:
        family, model = self._family(), self._model()
        if model is not None:
            fallback = str(model.fallback).lower()
            family.add_metric([model.name, str(model.version), model.bundle.digest, fallback], 1.0)
        yield family

    @staticmethod
    def _family() -> GaugeMetricFamily:
        return GaugeMetricFamily(
            "cspace_model_info",
            "The model that answers requests that name none.",
            labels=("name", "version", "digest", "fallback"),
        )


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
        record = RequestRecord(sent if _SENT_ID.fullmatch(sent) else secrets.token_hex(16))
        began = time.perf_counter()

        async def labelled(message: Message) -> None:
            if message["type"] == "http.response.start":
                record.status = message["status"]
                headers = list(message.get("headers", ()))
                own = {name for name, _ in headers}
                headers += [header for header in _RAW_SECURITY_HEADERS if header[0] not in own]
                message["headers"] = [*headers, (b"x-request-id", record.request_id.encode())]
            await send(message)

        token = request_record.set(record)
        try:
            with self._metrics.in_flight.track_inprogress():
                await self._app(scope, receive, labelled)
        except asyncio.CancelledError:
            if record.status is None:
                await problem_response(_SHUT_DOWN)(scope, receive, labelled)
            raise
        except Exception as error:
            if record.status is not None:
                raise
            await problem_response(error)(scope, receive, labelled)
        finally:
            self._finish(scope, record, 1e3 * (time.perf_counter() - began))
            request_record.reset(token)

    def _finish(self, scope: Scope, record: RequestRecord, duration_ms: float) -> None:
        state = scope.get("state", {})
        record.reason = state.get("problem")
        # Of mounted files it is the folder.
        record.route = getattr(scope.get("route"), "path", scope.get("root_path")) or "unknown"
        record.method = scope["method"] if scope["method"] in METHODS else "other"
        record.duration_ms = round(duration_ms, 3)
        self._metrics.requests.labels(record.route, record.method, str(record.status or 0)).inc()
        if record.reason is not None:
            self._metrics.failures.labels(record.reason).inc()
        # Nothing in it is free text of the client's.
        fields = ((name, getattr(record, name)) for name in record.__slots__)
        known = {name: value for name, value in fields if value is not None}
        _ACCESS_LOG.info("%s %s %s", record.method, record.route, record.status, extra={"fields": known})


_SHUT_DOWN = RequestError(
    SHUTTING_DOWN,
    "the server was told to end before this request was answered",
    remedy="ask again: another process may answer by then",
    headers={"Connection": "close", "Retry-After": "1"},
)


class LineFormatter(logging.Formatter):
    """``LEVEL:     message name=value ...``, or an object of JSON; a line inside a request has its id."""

    def __init__(self, form: str) -> None:
        super().__init__("%(levelname)s:     %(message)s%(tail)s")
        self._is_json = form == "json"

    def format(self, record: logging.LogRecord) -> str:
        """The line."""
        request = request_record.get()
        fields: dict[str, Any] = {} if request is None else {"request_id": request.request_id}
        fields |= getattr(record, "fields", {})
        if not self._is_json:
            record.tail = "".join(
                f" {name}={value}"
                for name, value in fields.items()
                if name not in ("method", "route", "status")
            )
            return super().format(record)
        line = {
            "time": datetime.fromtimestamp(record.created, UTC).isoformat(timespec="milliseconds"),
            "level": record.levelname.lower(),
            "logger": record.name,
            "message": record.getMessage(),
            **fields,
        }
        if record.exc_info:
            line["exception"] = self.formatException(record.exc_info)
        return json.dumps(line, default=str)


def log_settings(form: str) -> dict[str, Any]:
    """For :func:`logging.config.dictConfig`: all to standard error, the project's own from INFO on."""
    return {
        "version": 1,
        "disable_existing_loggers": False,
        "formatters": {"line": {"()": f"{__name__}.LineFormatter", "form": form}},
        "handlers": {"standard-error": {"class": "logging.StreamHandler", "formatter": "line"}},
        "root": {"level": "WARNING", "handlers": ["standard-error"]},
        "loggers": {
            "inference_api": {"level": "INFO"},
            "uvicorn": {"level": "INFO"},
            # What the parser thinks of a client's bytes is told to the client.
            "python_multipart": {"level": "ERROR"},
            # Their warnings name the registry's address.
            "mlflow": {"level": "ERROR"},
            "urllib3": {"level": "ERROR"},
        },
    }


def add_tracing(app: FastAPI) -> "TracerProvider":
    """Sends a span for every request but those that only watch, by OpenTelemetry's own variables.

    Raises:
        ConfigError: the packages are not installed.
    """
    try:
        from opentelemetry.exporter.otlp.proto.http.trace_exporter import OTLPSpanExporter  # noqa: PLC0415
        from opentelemetry.instrumentation.fastapi import FastAPIInstrumentor  # noqa: PLC0415
        from opentelemetry.sdk.resources import Resource  # noqa: PLC0415
        from opentelemetry.sdk.trace import TracerProvider  # noqa: PLC0415
        from opentelemetry.sdk.trace.export import BatchSpanProcessor  # noqa: PLC0415
    except ModuleNotFoundError as error:
        raise ConfigError(
            "traces cannot be sent",
            expected="the packages of the extra tracing",
            got=str(error),
            remedy=f"pip install 'cspace-sampler[tracing]', or unset {' and '.join(TRACES_ENDPOINTS)}",
        ) from error
    named = "OTEL_SERVICE_NAME" in os.environ
    provider = TracerProvider(
        resource=Resource.create({} if named else {"service.name": "cspace-sampler-api"})
    )
    provider.add_span_processor(BatchSpanProcessor(OTLPSpanExporter()))
    FastAPIInstrumentor.instrument_app(
        app,
        tracer_provider=provider,
        excluded_urls=",".join(f"{path}$" for path in (*HEALTH, METRICS)),
        exclude_spans=["receive", "send"],
    )
    return provider


async def _metrics_of(request: Request) -> Metrics:
    metrics: Metrics = request.app.state.metrics
    return metrics


# What routes take.
Metered = Annotated[Metrics, Depends(_metrics_of)]
