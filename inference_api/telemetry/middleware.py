"""ASGI middleware round all others that answer: a request's id, its metrics, its line in the log."""

import time

from starlette.datastructures import Headers, MutableHeaders
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from inference_api.record import RequestRecord, begin, choose_request_id, end
from inference_api.telemetry.access_log import log_request
from inference_api.telemetry.metrics import Metrics
from inference_api.telemetry.route_names import RouteNames

HEADER = "X-Request-ID"


class Observed:
    """Watches every request.

    Args:
        app: what is watched.
        metrics: of the app.
        names: templates of the app's routes.
    """

    def __init__(self, app: ASGIApp, metrics: Metrics, names: RouteNames) -> None:
        self._app = app
        self._metrics = metrics
        self._names = names

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Pass a request on."""
        if scope["type"] != "http":
            await self._app(scope, receive, send)
            return
        record = RequestRecord(choose_request_id(Headers(scope=scope).get(HEADER)))
        path, began, status = scope["path"], time.perf_counter(), 0

        async def named(message: Message) -> None:
            nonlocal status
            if message["type"] == "http.response.start":
                status = message["status"]
                MutableHeaders(scope=message)[HEADER] = record.request_id
            await send(message)

        token = begin(record)
        self._metrics.in_flight.inc()
        try:
            await self._app(scope, receive, named)
        finally:
            self._metrics.in_flight.dec()
            route = self._names.of(path)
            self._metrics.answered(route, scope["method"], status, record)
            log_request(record, scope["method"], route, status, time.perf_counter() - began)
            end(token)
