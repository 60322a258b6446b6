"""Optional traces: a span a request and one for each of its stages, sent by OTLP to whoever collects them.

Everything is set by OpenTelemetry's own variables (``OTEL_EXPORTER_OTLP_ENDPOINT``, ``OTEL_SERVICE_NAME``,
``OTEL_TRACES_SAMPLER``, ...). Without an endpoint nothing is imported, nothing is traced, nothing is sent.
"""

import os
import time
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

from fastapi import FastAPI

from cspace.errors import ConfigError
from inference_api.limits import HEALTH, METRICS
from inference_api.logs import request_record
from inference_api.models.served import ServedModel
from inference_api.settings import TRACES_ENDPOINTS
from inference_api.telemetry import STAGES, Answered, Metrics

if TYPE_CHECKING:
    from opentelemetry.sdk.trace import TracerProvider

SERVICE = "cspace-sampler-api"


def otlp_provider() -> "TracerProvider":
    """A provider that sends spans in batches, from a thread of its own.

    Raises:
        ConfigError: the packages are not installed.
    """
    try:
        from opentelemetry.exporter.otlp.proto.http.trace_exporter import OTLPSpanExporter  # noqa: PLC0415
        from opentelemetry.instrumentation import asgi as _  # noqa: F401, PLC0415
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
    provider = TracerProvider(resource=Resource.create({} if named else {"service.name": SERVICE}))
    provider.add_span_processor(BatchSpanProcessor(OTLPSpanExporter()))
    return provider


def add_tracing(app: FastAPI, provider: "TracerProvider") -> None:
    """Traces every request but those that only watch; to be added last, so that nothing is outside."""
    from opentelemetry.instrumentation.asgi import OpenTelemetryMiddleware  # noqa: PLC0415

    app.add_middleware(
        OpenTelemetryMiddleware,
        tracer_provider=provider,
        excluded_urls=",".join(f"{path}$" for path in (*HEALTH, METRICS)),
        exclude_spans=["receive", "send"],
    )


class TracedMetrics(Metrics):
    """Metrics of an app whose requests are traced.

    Args:
        provider: of the spans.
        model: as of :class:`Metrics`.
        shared: as of :class:`Metrics`.
    """

    def __init__(
        self, provider: "TracerProvider", model: Callable[[], ServedModel | None], shared: Path | None
    ) -> None:
        super().__init__(model, shared)
        self._tracer = provider.get_tracer("inference_api")

    def answered(self, answer: Answered) -> None:
        """Sets attributes on the request's span, and adds a span for each stage; the last one ends now."""
        from opentelemetry.trace import get_current_span  # noqa: PLC0415

        record = request_record.get()
        values: dict[str, str | bool | float | None] = {
            "request_id": "" if record is None else record.request_id,
            "model": str(answer.served),
            "fallback": answer.served.fallback,
            "n": answer.n,
            # In decimal, for an attribute has 63 bits.
            "seed": None if answer.seed is None else str(answer.seed),
            "shortfall": answer.shortfall,
            "acceptance": answer.acceptance,
            "status": answer.status,
        }
        span = get_current_span()
        span.set_attributes({f"cspace.{name}": value for name, value in values.items() if value is not None})
        # All but the last, which is their sum, in the order in which they come to pass.
        stages = [(name, answer.stages_s[name]) for name in STAGES[:-1] if name in answer.stages_s]
        begin = time.time_ns() - int(1e9 * sum(seconds for _, seconds in stages))
        for name, seconds in stages:
            end = begin + int(1e9 * seconds)
            self._tracer.start_span(name, start_time=begin).end(end)
            begin = end
        super().answered(answer)
