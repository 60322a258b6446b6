"""What is known of requests afterwards: Prometheus metrics, and the middleware that counts and logs them.

Every label of a metric has a bounded set of values: templates of routes, problem types, the methods of HTTP,
statuses that the server itself chooses, one model.
"""

import asyncio
import logging
import re
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from functools import cached_property, partial
from pathlib import Path
from typing import Literal, get_args

from fastapi.routing import iter_route_contexts
from prometheus_client import CollectorRegistry, Counter, Gauge, Histogram, generate_latest
from prometheus_client.core import GaugeMetricFamily, Metric
from prometheus_client.multiprocess import MultiProcessCollector
from prometheus_client.process_collector import ProcessCollector
from prometheus_client.registry import Collector
from starlette.datastructures import Headers
from starlette.responses import Response
from starlette.routing import BaseRoute, Mount, compile_path
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from cspace.query import Status
from inference_api.limits import RAW_SECURITY_HEADERS
from inference_api.logs import RequestRecord, choose_request_id, log_request, request_record
from inference_api.models.served import ServedModel
from inference_api.models.store import Refusal
from inference_api.problem_types import PROBLEMS, SHUTTING_DOWN, failure_response, problem_response
from services.outcomes import RESULTS

CONTENT_TYPE = "text/plain; version=0.0.4; charset=utf-8"
REQUEST_ID = "X-Request-ID"
STAGES = ("decode", "encode", "generate", "total")
METHODS = frozenset({"GET", "HEAD", "POST", "PUT", "PATCH", "DELETE", "OPTIONS", "TRACE", "CONNECT"})
# The name of paths without a route in metrics and log.
UNKNOWN = "unknown"
_NO_REASON = "none"
# From a picture that is known and a small network to a large n on a busy processor, in s.
_STAGE_BUCKETS_S = (0.0005, 0.001, 0.0025, 0.005, 0.01, 0.025, 0.05, 0.1, 0.25, 0.5, 1.0, 2.5, 5.0, 10.0)
_ACCEPTANCE_BUCKETS = (0.05, 0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8, 0.9, 0.95, 1.0)
_LOG = logging.getLogger(__name__)


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
        shared: the folder in which all processes of one server keep their values
            (``PROMETHEUS_MULTIPROC_DIR``); None for a single process.
    """

    def __init__(self, model: Callable[[], ServedModel | None], shared: Path | None = None) -> None:
        self._shared, self._model = shared, _ModelCollector(model)
        self._registry = registry = CollectorRegistry()
        counter, histogram = partial(Counter, registry=registry), partial(Histogram, registry=registry)
        gauge = partial(Gauge, registry=registry, multiprocess_mode="livesum")
        self._requests = counter(
            "cspace_requests", "Requests answered, by template of the route.", ("route", "method", "status")
        )
        self._failures = counter(
            "cspace_failures", "Answers that were problems, by problem type.", ("reason",)
        )
        self.in_flight = gauge("cspace_requests_in_flight", "Requests being answered.")
        self.waiting = gauge("cspace_requests_waiting", "Requests that wait for their turn to be computed.")
        self.connections = gauge("cspace_connections", "Connections that are open.")
        stages = histogram(
            "cspace_stage_seconds",
            "Time in each stage of an answer with samples.",
            ("stage",),
            buckets=_STAGE_BUCKETS_S,
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
        self._fallbacks = counter(
            "cspace_fallback_answers", "Answers of the shipped model in a champion's stead."
        )
        self._reloads = counter(
            "cspace_model_reloads", "Champions put into service, or refused.", ("outcome", "reason")
        )
        self._outcomes = counter("cspace_outcomes", "Outcomes written to disk, or lost.", ("result",))
        # Else a rate over the first event of a kind would see no rise.
        for result in RESULTS:
            self._outcomes.labels(result)
        for problem in PROBLEMS:
            self._failures.labels(problem.name)
        for status in get_args(Status):
            self._plans.labels(status)
        self._stage = {stage: stages.labels(stage) for stage in STAGES}
        self._reloads.labels("served", _NO_REASON)
        for reason in get_args(Refusal):
            self._reloads.labels("refused", reason)
        ProcessCollector(registry=registry)
        registry.register(self._model)

    def answered(self, answer: Answered) -> None:
        """Counts an answer, and writes it down for the request's line in the log."""
        if answer.served.fallback:
            self._fallbacks.inc()
        if answer.kind == "samples":
            for stage, seconds in answer.stages_s.items():
                self._stage[stage].observe(seconds)
            self._acceptance.observe(answer.acceptance or 0.0)
            self._requested.inc(answer.n or 0)
            self._returned.inc((answer.n or 0) - (answer.shortfall or 0))
        elif answer.kind == "scores":
            self._scored.inc(answer.n or 0)
        elif answer.kind == "plan":
            self._plans.labels(answer.status).inc()
        record = request_record.get()
        if record is not None:
            record.model, record.n = str(answer.served), answer.n
            record.seed, record.shortfall = answer.seed, answer.shortfall

    def followed(self, refusal: Refusal | None) -> None:
        """Counts a champion that was put into service, or was not for a reason."""
        outcome = "served" if refusal is None else "refused"
        self._reloads.labels(outcome, refusal or _NO_REASON).inc()

    def outcomes(self, result: str, count: int) -> None:
        """Counts outcomes that were written, or are lost."""
        self._outcomes.labels(result).inc(count)

    def finished(self, route: str, method: str, status: int, record: RequestRecord) -> None:
        """Counts a request."""
        known = method if method in METHODS else "other"
        self._requests.labels(route, known, str(status)).inc()
        if record.reason is not None:
            self._failures.labels(record.reason).inc()

    def render(self) -> bytes:
        """All metrics in Prometheus' text format; of several processes their sums, and this one's model."""
        if self._shared is None:
            return generate_latest(self._registry)
        together = CollectorRegistry()
        MultiProcessCollector(together, path=str(self._shared))  # type: ignore[no-untyped-call]
        together.register(self._model)
        return generate_latest(together)


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

    It is the last resort, too: an error that nobody caught is logged and answered with 500, and a request
    that is cancelled at the server's end is told so with 503 and stays cancelled.

    Args:
        app: what is watched.
        metrics: of the app.
        routes: of the app, whose templates name paths; looked at with the first request.
    """

    def __init__(self, app: ASGIApp, metrics: Metrics, routes: Sequence[BaseRoute]) -> None:
        self._app, self._metrics, self._routes = app, metrics, routes

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Passes a request on."""
        if scope["type"] != "http":
            await self._app(scope, receive, send)
            return
        record = RequestRecord(choose_request_id(Headers(scope=scope).get(REQUEST_ID)), scope["path"])
        began, status = time.perf_counter(), 0

        async def labelled(message: Message) -> None:
            nonlocal status
            if message["type"] == "http.response.start":
                status, headers = message["status"], list(message.get("headers", ()))
                own = {name.lower() for name, _ in headers}
                headers += [header for header in RAW_SECURITY_HEADERS if header[0] not in own]
                message["headers"] = [*headers, (REQUEST_ID.lower().encode(), record.request_id.encode())]
            await send(message)

        token = request_record.set(record)
        self._metrics.in_flight.inc()
        try:
            await self._app(scope, receive, labelled)
        except asyncio.CancelledError:
            if not status:
                await _cut_off()(scope, receive, labelled)
            raise
        except Exception as error:
            if status:
                raise
            _LOG.exception("an error that nobody foresaw")
            await failure_response(error)(scope, receive, labelled)
        finally:
            self._metrics.in_flight.dec()
            route, method = self._route(record.path), scope["method"]
            self._metrics.finished(route, method, status, record)
            log_request(record, method, route, status, time.perf_counter() - began)
            request_record.reset(token)

    def _route(self, path: str) -> str:
        return next((name for pattern, name in self._patterns if pattern.match(path)), UNKNOWN)

    @cached_property
    def _patterns(self) -> list[tuple[re.Pattern[str], str]]:
        patterns = []
        for route in iter_route_contexts(self._routes):
            path = route.path or ""
            whole = f"{path}/{{path:path}}" if isinstance(route.original_route, Mount) else path
            patterns.append((compile_path(whole)[0], path))
        return patterns


def _cut_off() -> Response:
    return problem_response(
        SHUTTING_DOWN,
        "the server was told to end before this request was answered",
        remedy="ask again: another process may answer by then",
        headers={"Connection": "close", "Retry-After": "1"},
    )
