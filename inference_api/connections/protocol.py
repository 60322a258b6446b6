"""uvicorn's protocol for httptools, with bounds on what a client may send, hold and leave unread."""

import asyncio
from typing import TYPE_CHECKING, Any, cast

import httptools
from uvicorn.protocols.http.httptools_impl import HttpToolsProtocol, RequestResponseCycle
from uvicorn.server import ServerState

from inference_api.connections.answering import closing_where_unread
from inference_api.connections.bounds import MessageBounds, RefusedError
from inference_api.connections.departure import DEPARTURE, Departure
from inference_api.connections.linger import LingeringTransport
from inference_api.connections.refusal import Refusal, refuse
from inference_api.guards.addresses import subscriber
from inference_api.problems import HEADERS_TIMEOUT, MALFORMED_REQUEST

if TYPE_CHECKING:
    from uvicorn._types import ASGI3Application

    from inference_api.connections.config import ApiConfig

# A client that reads takes less for what a buffer holds.
UNREAD_S = 1.0
_MALFORMED = Refusal(MALFORMED_REQUEST, "these bytes are no HTTP/1.1", "use an HTTP client")
_QUEUE = Refusal(
    MALFORMED_REQUEST,
    "too many requests were sent on this connection before they were answered",
    "wait for answers, or open further connections",
)
_UPGRADE = Refusal(
    MALFORMED_REQUEST,
    "a request that asks for another protocol can have no body here",
    "send it as HTTP/1.1 without Upgrade",
)


class BoundedProtocol(HttpToolsProtocol):
    """One connection.

    Args:
        config: of the server, with the limits and the table of connections.
        server_state: uvicorn's.
        app_state: uvicorn's.
        _loop: uvicorn's.
    """

    def __init__(
        self,
        config: "ApiConfig",
        server_state: ServerState,
        app_state: dict[str, Any],
        _loop: asyncio.AbstractEventLoop | None = None,
    ) -> None:
        super().__init__(config, server_state, app_state, _loop)
        self._limits, self._table, self._metrics = config.limits, config.table, config.metrics
        self._bounds = MessageBounds(config.limits)
        self._departure = Departure()
        self.address = "unknown"
        self.waiting_since = self.loop.time()
        # Answers that are owed, the one that is being made, and what is said after the last one.
        self._owed = 0
        self._running: RequestResponseCycle | None = None
        self._refusal: Refusal | None = None
        # Since when a head is arriving, and since when how much is unsent.
        self._head_since: float | None = self.waiting_since
        self._unsent: tuple[float, int] | None = None
        # Once deaf, bytes are thrown away; once lingering, for a bounded time.
        self._deaf = False
        self._thrown_away = 0
        self._linger_until: float | None = None

    @property
    def busy(self) -> bool:
        """Whether an answer is being made; one that its client does not read counts as waiting."""
        return self._owed > 0 and not self.flow.write_paused

    def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]
        """Take a place in the table."""
        super().connection_made(transport)
        self.address = subscriber(self.client[0] if self.client else "unknown")
        self._table.add(self, self.loop)

    def connection_lost(self, exc: Exception | None) -> None:
        """Give the place back, and tell the answer that is being made."""
        self._table.remove(self)
        self.pipeline.clear()
        self._departure.tell()
        if self._running is not None:
            # uvicorn tells the last of several alone.
            self._running.disconnected = True
            self._running.message_event.set()
        super().connection_lost(exc)

    def cut(self) -> None:
        """Close, whatever is unsent."""
        self._table.remove(self)
        self.transport.abort()

    def data_received(self, data: bytes) -> None:
        """Feed the parser, and count what it was fed."""
        if self._deaf:
            self._throw_away(len(data))
            return
        part = self._bounds.part
        if self._head_since is None and self._bounds.in_head:
            self._head_since = self.loop.time()
        self._unset_keepalive_if_required()
        try:
            self.parser.feed_data(data)
            if part == self._bounds.part:
                self._bounds.fed(len(data))
        except RefusedError as error:
            self._refuse(error.refusal)
        except httptools.HttpParserUpgrade:
            # The request is answered as any other; what follows would be another protocol.
            self._deaf = True
            self.cycle.keep_alive = False
            self.cycle.transport = self._lingering()
        except httptools.HttpParserError as error:
            cause = error.__context__
            self._refuse(cause.refusal if isinstance(cause, RefusedError) else _MALFORMED)

    def on_url(self, url: bytes) -> None:
        """A piece of the target."""
        self._bounds.target(len(url), len(self.url) + len(url))
        super().on_url(url)

    def on_header(self, name: bytes, value: bytes) -> None:
        """A header; a trailer is dropped, for the guards have decided by the headers already."""
        self._bounds.header(len(name) + len(value) + 4)
        if self._bounds.in_head:
            super().on_header(name, value)

    def on_headers_complete(self) -> None:
        """Begin to answer, or queue the request."""
        if len(self.pipeline) >= self._limits.pipelined:
            raise RefusedError(_QUEUE)
        if self.parser.should_upgrade() and any(_announces_body(*header) for header in self.headers):
            raise RefusedError(_UPGRADE)
        cast("dict[str, Any]", self.scope)[DEPARTURE] = self._departure
        super().on_headers_complete()
        self._owed += 1
        self._head_since = None
        self._bounds.next_part()

    def on_body(self, body: bytes) -> None:
        """A piece of the body."""
        self._bounds.body(len(body))
        super().on_body(body)

    def on_message_complete(self) -> None:
        """The next head begins with the next byte."""
        super().on_message_complete()
        self._bounds.next_part()
        self._head_since = None
        if not self.pipeline:
            # uvicorn stops reading while much of a body waits, and would not see that the client leaves.
            self.flow.resume_reading()

    def on_response_complete(self) -> None:
        """Go on with the next request, or say the last word."""
        self._owed -= 1
        self.waiting_since = self.loop.time()
        self._running = None
        super().on_response_complete()
        if self.pipeline and self._linger_until is None and not self.transport.is_closing():
            # uvicorn reads on after each answer, and a client that is ahead could lengthen its queue.
            self.flow.pause_reading()
        if self._refusal is not None and self._owed == 0:
            self._say(self._refusal)

    def look(self, now: float) -> None:
        """End what is overdue."""
        limits, size = self._limits, self.transport.get_write_buffer_size()
        if not size:
            self._unsent = None
        elif self._unsent is None:
            self._unsent = (now, size)
        elif now - self._unsent[0] > limits.write_timeout_s + self._unsent[1] / limits.write_bytes_per_s:
            self.cut()
            return
        if self._linger_until is not None:
            if now > self._linger_until:
                self.transport.close()
        elif self.flow.read_paused or self._deaf:
            # It is not the client who is slow.
            self._head_since = None if self._head_since is None else now
        elif self._head_since is not None and now - self._head_since > limits.header_timeout_s:
            self._head_is_late()

    def unread_bytes(self, now: float) -> int:
        """What the client has left unread for a while."""
        if self._unsent is None or now - self._unsent[0] < UNREAD_S:
            return 0
        return self.transport.get_write_buffer_size()

    def resume_writing(self) -> None:
        """Enough was read for the client to have all its time again."""
        self._unsent = None
        super().resume_writing()

    def _unsupported_upgrade_warning(self) -> None:
        """Nothing: a client's wish is no warning."""

    def _start_asgi_task(self, cycle: RequestResponseCycle, app: "ASGI3Application") -> None:
        self._running = cycle
        super()._start_asgi_task(cycle, closing_where_unread(app, cycle, self._lingering))

    def _head_is_late(self) -> None:
        if self._bounds.untouched:
            self.transport.close()
            return
        limit_s = self._limits.header_timeout_s
        detail = f"the headers were not complete within {limit_s:g} s"
        self._refuse(Refusal(HEADERS_TIMEOUT, detail, "send them at once"))

    def _refuse(self, refusal: Refusal) -> None:
        """Read no further, and say so once all that came before is answered."""
        self._deaf = True
        self._head_since = None
        if not self._bounds.in_head:
            if self.cycle.response_started:
                # That answer closes the connection, for it began before the body was complete.
                return
            self._give_body_up()
        self._refusal = refusal
        if self._owed == 0:
            self._say(refusal)

    def _give_body_up(self) -> None:
        """The body is lost: its request leaves the queue, or learns that there is no more."""
        self._owed -= 1
        if self.pipeline:
            self.pipeline.popleft()
            return
        self.cycle.disconnected = True
        self.cycle.message_event.set()

    def _say(self, refusal: Refusal) -> None:
        if self.transport.is_closing() or self._linger_until is not None:
            return
        self.transport.write(refuse(refusal, self._metrics, self.server_state.default_headers))
        self._linger()

    def _lingering(self) -> asyncio.Transport:
        return cast("asyncio.Transport", LingeringTransport(self.transport, self._linger))

    def _linger(self) -> None:
        self._deaf = True
        if self.transport.is_closing() or self._linger_until is not None:
            return
        self._linger_until = self.loop.time() + self._limits.linger_s
        self.flow.resume_reading()
        if self.transport.can_write_eof():
            self.transport.write_eof()

    def _throw_away(self, size: int) -> None:
        self._thrown_away += size
        if self._thrown_away > self._limits.linger_bytes:
            self.transport.close()


def _announces_body(name: bytes, value: bytes) -> bool:
    return name == b"transfer-encoding" or (name == b"content-length" and value.strip(b" 0") != b"")
