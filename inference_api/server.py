"""uvicorn's configuration and its h11 protocol, with bounds on connections.

uvicorn has no deadline for a request's head on a new connection, no bound on what clients leave unread, and
refuses everybody's requests where one has opened too many connections. :class:`BoundedProtocol` adds these
three; nginx does the rest in deployments (docs/security.md). Light to import, for it is made before all else.
"""

import asyncio
import logging
import resource
import socket
import sys
from collections import defaultdict
from typing import TYPE_CHECKING, Any, cast

import h11
import uvicorn
from uvicorn.protocols.http.h11_impl import STATUS_PHRASES, H11Protocol, RequestResponseCycle

from inference_api.limits import RAW_SECURITY_HEADERS, client_of
from inference_api.logs import RequestRecord, choose_request_id, log_request, request_record
from inference_api.problem_types import (
    HEADERS_TIMEOUT,
    HEADERS_TOO_LARGE,
    MALFORMED_REQUEST,
    ProblemType,
    problem_response,
)
from inference_api.process import end_in_time
from inference_api.settings import ConnectionLimits

if TYPE_CHECKING:
    from inference_api.telemetry import Metrics

KEEP_ALIVE_S = 60
SWITCH_S = 0.00005
# Of request line and headers together.
MAX_HEAD_BYTES = 40 * 1024
# Answers that the clients of one address leave unread for so long, in all.
UNREAD_S, MAX_UNREAD_BYTES = 1.0, 16 * 2**20
# What is unsent lengthens the time that a client has for reading.
_READ_BYTES_PER_S = 64 * 1024
# Open files beside connections: the log, the event loop, pipes to processes, models that are read.
_OTHER_FILES = 64
_LOG = logging.getLogger(__name__)
# Of uvicorn's protocol; :mod:`inference_api.logs` sets its level.
_PROTOCOL_LOG = logging.getLogger(f"{__name__}.protocol")


def _is_no_cancellation(record: logging.LogRecord) -> bool:
    # At the server's end, what is in flight is cancelled on purpose; uvicorn would log each as an error.
    return not (record.exc_info and isinstance(record.exc_info[1], asyncio.CancelledError))


_PROTOCOL_LOG.addFilter(_is_no_cancellation)


class ApiConfig(uvicorn.Config):
    """The configuration of one server; it travels to each of its processes, where it is loaded.

    Args:
        limits: of connections.
        grace_s: for requests in flight when the server is told to end, in whole s.
        workers: processes.
        log_config: for :func:`logging.config.dictConfig`.
        load_planner: whether the search of plans is loaded before the server is ready.
    """

    metrics: "Metrics"

    def __init__(
        self,
        limits: ConnectionLimits,
        grace_s: int,
        workers: int,
        log_config: dict[str, object],
        *,
        load_planner: bool,
    ) -> None:
        super().__init__(
            "inference_api.app:create_app",
            factory=True,
            http=BoundedProtocol,
            # uvloop accepts one connection in each turn of the loop: behind hundreds a new one waits seconds.
            loop="asyncio",
            # A request to upgrade is answered as a request, by the limits and the routes.
            ws="none",
            workers=workers,
            timeout_keep_alive=KEEP_ALIVE_S,
            timeout_graceful_shutdown=grace_s,
            h11_max_incomplete_event_size=MAX_HEAD_BYTES,
            log_config=log_config,
            # The app writes one line a request of its own, and knows which proxies it trusts.
            access_log=False,
            proxy_headers=False,
            server_header=False,
        )
        self.limits, self.grace_s, self.load_planner = limits, grace_s, load_planner
        self.most_connections = limits.connections

    def load(self) -> None:
        """Loads the app, in the process that serves and after uvicorn has taken the signals."""
        super().load()
        # A request comes back to the interpreter after every graph, and would each time wait for 5 ms while
        # the event loop is busy with somebody's small requests.
        sys.setswitchinterval(SWITCH_S)
        self.metrics = self.loaded_app.state.metrics
        self.loaded_app.state.loads_planner = self.load_planner
        self.most_connections = within_open_files(self.limits.connections)
        end_in_time(self.grace_s)


def within_open_files(connections: int) -> int:
    """How many connections a process may have that may open only so many files; its soft limit is raised.

    Each connection is a file. Without one left nobody could connect, and idle ones would never be cut for it.
    """
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    if soft != hard:
        resource.setrlimit(resource.RLIMIT_NOFILE, (hard, hard))
    most = connections if hard == resource.RLIM_INFINITY else max(1, hard - _OTHER_FILES)
    if connections > most:
        _LOG.warning("at most %d connections, not %d: the process may open %d files", most, connections, hard)
    return min(connections, most)


class BoundedProtocol(H11Protocol):
    """One connection: heads have a deadline, unread answers a bound, and one too many cuts an idle one."""

    config: ApiConfig

    def __init__(self, *arguments: Any, **options: Any) -> None:
        super().__init__(*arguments, **options)
        self.logger = _PROTOCOL_LOG
        self.address = "unknown"
        self.waiting_since = self.loop.time()
        self._head_timer: asyncio.TimerHandle | None = None
        self._read_timer: asyncio.TimerHandle | None = None

    @property
    def is_waiting(self) -> bool:
        """Whether no answer is being made, or its client does not read it."""
        cycle: RequestResponseCycle | None = self.cycle
        return cycle is None or cycle.response_complete or self.flow.write_paused

    def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]
        """Takes a place, for which another connection may have to go."""
        super().connection_made(transport)
        # asyncio leaves it out for such listeners, and answers are two packets: the head and the body.
        transport.get_extra_info("socket").setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        self.address = client_of({"client": self.client})
        self.config.metrics.connections.inc()
        self._await_head(fresh=True)
        if len(self.connections) > self.config.most_connections:
            self._dispensable().transport.abort()

    def connection_lost(self, exc: Exception | None) -> None:
        """Gives the place back."""
        self.config.metrics.connections.dec()
        for timer in (self._head_timer, self._read_timer):
            if timer is not None:
                timer.cancel()
        super().connection_lost(exc)

    def data_received(self, data: bytes) -> None:
        """Feeds the parser."""
        super().data_received(data)
        self._await_head()

    def on_response_complete(self) -> None:
        """Goes on with the next request."""
        self.waiting_since = self.loop.time()
        super().on_response_complete()
        self._await_head()

    def pause_writing(self) -> None:
        """The client reads more slowly than answers are written."""
        super().pause_writing()
        self._read_timer = self.loop.call_later(UNREAD_S, self._check_unread)

    def resume_writing(self) -> None:
        """The client has read enough to have all its time again."""
        if self._read_timer is not None:
            self._read_timer.cancel()
            self._read_timer = None
        super().resume_writing()

    def send_400_response(self, msg: str) -> None:  # noqa: ARG002 - uvicorn's words
        """Answers what is no HTTP with a problem; uvicorn calls it where h11 refuses to read on."""
        error = sys.exc_info()[1]
        if getattr(error, "error_status_hint", 400) == HEADERS_TOO_LARGE.status:
            limit = f"more than {MAX_HEAD_BYTES} bytes of headers"
            self._refuse(HEADERS_TOO_LARGE, limit, "send fewer and shorter headers")
        else:
            self._refuse(MALFORMED_REQUEST, "these bytes are no HTTP/1.1", "use an HTTP client")

    def _await_head(self, *, fresh: bool = False) -> None:
        """Starts the clock of a head that has begun to arrive, and stops it when the head is complete.

        The rest of a body that was answered without being read has the same time: it is thrown away.
        """
        theirs = self.conn.their_state
        arriving = theirs is h11.IDLE and (fresh or bool(self.conn.trailing_data[0]))
        if self._head_timer is None and (arriving or self._is_unwanted_body):
            self._head_timer = self.loop.call_later(self.config.limits.header_timeout_s, self._late)
        elif self._head_timer is not None and theirs is not h11.IDLE and not self._is_unwanted_body:
            self._head_timer.cancel()
            self._head_timer = None

    @property
    def _is_unwanted_body(self) -> bool:
        return self.conn.our_state is h11.DONE and self.conn.their_state is h11.SEND_BODY

    def _late(self) -> None:
        if self._is_unwanted_body or not self.conn.trailing_data[0]:
            self.transport.close()
            return
        limit_s = self.config.limits.header_timeout_s
        detail = f"the headers were not complete within {limit_s:g} s"
        self._refuse(HEADERS_TIMEOUT, detail, "send them at once")

    def _check_unread(self) -> None:
        others = [cast("BoundedProtocol", one) for one in self.connections]
        unread = sum(one.unsent for one in others if one.address == self.address)
        if unread > MAX_UNREAD_BYTES:
            self.transport.abort()
            return
        limit_s = self.config.limits.write_timeout_s + self.unsent / _READ_BYTES_PER_S
        self._read_timer = self.loop.call_later(limit_s, self.transport.abort)

    @property
    def unsent(self) -> int:
        """Bytes of answers that the client has not read."""
        return self.transport.get_write_buffer_size()

    def _dispensable(self) -> "BoundedProtocol":
        """The one that has waited longest, of the address that has most waiting: none shuts others out."""
        waiting: defaultdict[str, list[BoundedProtocol]] = defaultdict(list)
        for other in self.connections:
            one = cast("BoundedProtocol", other)
            if one is not self and one.is_waiting and not one.transport.is_closing():
                waiting[one.address].append(one)
        crowd = max(waiting.values(), key=len, default=[self])
        return min(crowd, key=lambda one: one.waiting_since)

    def _refuse(self, problem: ProblemType, detail: str, remedy: str) -> None:
        """Writes a whole answer that closes the connection; it is counted, and has its line in the log."""
        cycle: RequestResponseCycle | None = self.cycle
        if cycle is not None and not cycle.response_complete:
            cycle.disconnected = True
            cycle.message_event.set()
            if cycle.response_started:
                self.transport.close()
                return
        record = RequestRecord(choose_request_id(None))
        token = request_record.set(record)
        response = problem_response(problem, detail, remedy=remedy)
        self.config.metrics.finished("unknown", "other", problem.status, record)
        log_request(record, "other", "unknown", problem.status, 0.0)
        request_record.reset(token)
        own = [(b"x-request-id", record.request_id.encode()), (b"connection", b"close")]
        headers = (*self.server_state.default_headers, *response.raw_headers, *RAW_SECURITY_HEADERS, *own)
        start = b"HTTP/1.1 %d %s" % (problem.status, STATUS_PHRASES[problem.status])
        lines = [start, *(name + b": " + value for name, value in headers), b"", bytes(response.body)]
        self.transport.write(b"\r\n".join(lines))
        self.transport.close()


class SharedPort(socket.socket):
    """A port that is taken, and that each process to which it travels listens on by itself (SO_REUSEPORT).

    The kernel then shares connections out by their addresses. On one socket for all, whichever process wakes
    first takes every connection that is waiting: clients that keep theirs may all end up with one process.
    """

    @classmethod
    def taken(cls, host: str, port: int, family: socket.AddressFamily) -> "SharedPort":
        """The port, which nobody listens on yet.

        Raises:
            OSError: somebody else has it, or there is no such address.
        """
        # Whoever shares ports as well would be let in beside this; who is there already is found out so.
        with socket.create_server((host, port), family=family) as alone:
            address = alone.getsockname()
        shared = cls(family, socket.SOCK_STREAM)
        for option in (socket.SO_REUSEADDR, socket.SO_REUSEPORT):
            shared.setsockopt(socket.SOL_SOCKET, option, 1)
        shared.bind(address)
        return shared

    def __reduce__(self) -> tuple[Any, ...]:
        """As a listener of the process that reads it."""
        return _listening, (self.getsockname()[:2], self.family)


def _listening(address: tuple[str, int], family: socket.AddressFamily) -> socket.socket:
    return socket.create_server(address, family=family, reuse_port=True)
