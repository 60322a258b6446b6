"""One line a request."""

import logging

from inference_api.record import RequestRecord
from inference_api.telemetry.logs import FIELDS

_LOG = logging.getLogger("inference_api.access")


def log_request(record: RequestRecord, method: str, route: str, status: int, duration_s: float) -> None:
    """Write the line of a request that was answered; nothing in it is free text of the client's."""
    duration_ms = round(1e3 * duration_s, 3)
    fields = {
        "request_id": record.request_id,
        "client": record.client,
        "method": method,
        "route": route,
        "status": status,
        "duration_ms": duration_ms,
        "reason": record.reason,
        "model": record.model,
        "n": record.n,
        # JSON's numbers end at 53 bits.
        "seed": None if record.seed is None else str(record.seed),
        "shortfall": record.shortfall,
    }
    known = {name: value for name, value in fields.items() if value is not None}
    _LOG.info("%s %s %d", method, route, status, extra={FIELDS: known})
