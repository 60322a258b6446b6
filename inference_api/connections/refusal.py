"""Answers to what is not yet a request: made and told of here, for no page and no guard has seen it."""

from collections.abc import Iterable
from dataclasses import dataclass

from inference_api.guards.headers import RAW_SECURITY_HEADERS
from inference_api.problems import ProblemType, problem_response
from inference_api.record import RequestRecord, begin, choose_request_id, end
from inference_api.telemetry.access_log import log_request
from inference_api.telemetry.metrics import Metrics
from inference_api.telemetry.route_names import UNKNOWN

# What a client writes in their place is not repeated: it may be anything.
METHOD = "other"
_REASONS = {400: b"Bad Request", 408: b"Request Timeout", 414: b"URI Too Long"}
_REASONS[431] = b"Request Header Fields Too Large"


@dataclass(frozen=True, slots=True)
class Refusal:
    """Why a connection is not read on.

    Args:
        problem: the answer's type.
        detail: what was wrong.
        remedy: what to do instead.
    """

    problem: ProblemType
    detail: str
    remedy: str


def refuse(refusal: Refusal, metrics: Metrics, headers: Iterable[tuple[bytes, bytes]]) -> bytes:
    """A whole answer of HTTP/1.1 that closes the connection; it is counted, and has its line in the log.

    Args:
        refusal: that is told.
        metrics: of the app.
        headers: that every answer has.
    """
    record = RequestRecord(choose_request_id(None), reason=refusal.problem.name)
    # An answer of the same connection may just be ending: this one is not its.
    token = begin(record)
    response = problem_response(refusal.problem, refusal.detail, remedy=refusal.remedy)
    status = refusal.problem.status
    metrics.answered(UNKNOWN, METHOD, status, record)
    log_request(record, METHOD, UNKNOWN, status, 0.0)
    end(token)
    own = [(b"x-request-id", record.request_id.encode()), (b"connection", b"close")]
    every = (*headers, *response.raw_headers, *RAW_SECURITY_HEADERS, *own)
    lines = [b"HTTP/1.1 %d %s" % (status, _REASONS[status]), *(name + b": " + value for name, value in every)]
    return b"\r\n".join([*lines, b"", bytes(response.body)])
