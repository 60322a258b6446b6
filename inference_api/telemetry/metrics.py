"""The server's Prometheus metrics, in a registry of each app's own.

Every label has a bounded set of values: templates of routes, problem types, the methods of HTTP, statuses
that the server itself chooses, one model.
"""

from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from typing import Protocol, get_args

from prometheus_client import CollectorRegistry, Counter, Gauge, Histogram, generate_latest
from prometheus_client.core import GaugeMetricFamily, Metric
from prometheus_client.multiprocess import MultiProcessCollector
from prometheus_client.process_collector import ProcessCollector
from prometheus_client.registry import Collector

from cspace.query import Status
from inference_api.problems import PROBLEMS
from inference_api.record import RequestRecord, current
from inference_api.telemetry.observer import REFUSALS, Observer, Planned, Refusal, Sampled, Scored

CONTENT_TYPE = "text/plain; version=0.0.4; charset=utf-8"
STAGES = ("decode", "encode", "generate", "total")
NO_REASON = "none"
METHODS = frozenset({"GET", "HEAD", "POST", "PUT", "PATCH", "DELETE", "OPTIONS", "TRACE", "CONNECT"})
# From a picture that is known and a small network to a large n on a busy processor, in s.
STAGE_BUCKETS_S = (0.0005, 0.001, 0.0025, 0.005, 0.01, 0.025, 0.05, 0.1, 0.25, 0.5, 1.0, 2.5, 5.0, 10.0)
ACCEPTANCE_BUCKETS = (0.05, 0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8, 0.9, 0.95, 1.0)


class ModelInService(Protocol):
    """What is told of the model that answers."""

    name: str
    version: int
    digest: str
    fallback: bool


class Metrics(Observer):
    """Counts and times what one app does.

    Args:
        model: describes the model that answers by default, None without one; asked at each scrape.
        shared: the folder in which all processes of one server keep their values
            (``PROMETHEUS_MULTIPROC_DIR``); None for a single process.
    """

    def __init__(self, model: Callable[[], ModelInService | None], shared: Path | None = None) -> None:
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
            buckets=STAGE_BUCKETS_S,
        )
        self._acceptance = histogram(
            "cspace_acceptance_ratio",
            "Share of what was drawn that reached the confidence asked for, by answer.",
            buckets=ACCEPTANCE_BUCKETS,
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
        # Else a rate over the first event of a kind would see no rise.
        for problem in PROBLEMS:
            self._failures.labels(problem.name)
        for status in get_args(Status):
            self._plans.labels(status)
        self._stage = {stage: stages.labels(stage) for stage in STAGES}
        self._reloads.labels("served", NO_REASON)
        for reason in REFUSALS:
            self._reloads.labels("refused", reason)
        ProcessCollector(registry=registry)
        registry.register(self._model)

    def sampled(self, answer: Sampled) -> None:
        """Count an answer with samples, and write it down for the request's line in the log."""
        for stage, seconds in answer.stages_s.items():
            self._stage[stage].observe(seconds)
        self._acceptance.observe(answer.acceptance)
        self._requested.inc(answer.n)
        self._returned.inc(answer.n - answer.shortfall)
        if answer.fallback:
            self._fallbacks.inc()
        record = current()
        if record is not None:
            record.model, record.n = answer.model, answer.n
            record.seed, record.shortfall = answer.seed, answer.shortfall

    def scored(self, answer: Scored) -> None:
        """Count configurations that were scored, and write the answer down for its line in the log."""
        self._scored.inc(answer.n)
        if answer.fallback:
            self._fallbacks.inc()
        record = current()
        if record is not None:
            record.model, record.n = answer.model, answer.n

    def planned(self, answer: Planned) -> None:
        """Count a plan, and write the answer down for its line in the log."""
        self._plans.labels(answer.status).inc()
        if answer.fallback:
            self._fallbacks.inc()
        record = current()
        if record is not None:
            record.model, record.seed = answer.model, answer.seed

    def reloaded(self) -> None:
        """Count a champion that was put into service."""
        self._reloads.labels("served", NO_REASON).inc()

    def refused(self, reason: Refusal) -> None:
        """Count a champion that was not."""
        self._reloads.labels("refused", reason).inc()

    def answered(self, route: str, method: str, status: int, record: RequestRecord) -> None:
        """Count a request."""
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

    def __init__(self, model: Callable[[], ModelInService | None]) -> None:
        self._model = model

    def describe(self) -> Iterator[Metric]:
        yield self._family()

    def collect(self) -> Iterator[Metric]:
        family, model = self._family(), self._model()
        if model is not None:
            fallback = str(model.fallback).lower()
            family.add_metric([model.name, str(model.version), model.digest, fallback], 1.0)
        yield family

    @staticmethod
    def _family() -> GaugeMetricFamily:
        return GaugeMetricFamily(
            "cspace_model_info",
            "The model that answers requests that name none.",
            labels=("name", "version", "digest", "fallback"),
        )
