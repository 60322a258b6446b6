"""Who may ask, and how much: names and origins, keys, rates, places, and the size and time of bodies.

Two ASGI middlewares: :class:`Doors` outside of CORS, :class:`Limits` inside. Both refuse with problems.
"""

import asyncio
import ipaddress
import math
import time
from collections import defaultdict
from collections.abc import Callable, Iterable, MutableMapping
from functools import lru_cache
from typing import Literal

from cachetools import LRUCache
from fastapi import FastAPI
from fastapi.middleware.cors import CORSMiddleware
from starlette.datastructures import Headers
from starlette.types import ASGIApp, Message, Receive, Scope, Send
from uvicorn.middleware.proxy_headers import ProxyHeadersMiddleware

from inference_api.keys import ApiKeys, bearer_token, warn_of_readers
from inference_api.logs import request_record
from inference_api.problem_types import (
    BODY_TOO_LARGE,
    FOREIGN_ORIGIN,
    HEADERS_TOO_LARGE,
    OVERLOADED,
    REQUEST_TIMEOUT,
    TOO_MANY_REQUESTS,
    UNAUTHORIZED,
    UNKNOWN_HOST,
    URI_TOO_LONG,
    RequestError,
    problem_response,
    request_problem,
)
from inference_api.settings import ANY, Protection

MAX_BODY_BYTES = 8 * 1024 * 1024
# Clients whose rate, and whose part of the computing, is remembered.
MAX_CLIENTS = 4096
RETRY_AFTER_S = 1
LOOPBACK_NAMES = ("localhost", "127.0.0.1", "[::1]")
HEALTH = ("/health/live", "/health/ready", "/v2/health/live", "/v2/health/ready")
METRICS = "/metrics"
WORKBENCH_FILES = "/workbench/files"
REALM = 'Bearer realm="cspace-sampler"'
MAX_TARGET_BYTES, MAX_HEADERS, MAX_HEADER_BYTES = 8 * 1024, 100, 32 * 1024
# After OWASP's REST Security Cheat Sheet. A page that needs more, /docs, brings a policy of its own.
SECURITY_HEADERS = {
    "Cache-Control": "no-store",
    "Content-Security-Policy": "default-src 'none'; frame-ancestors 'none'",
    "Cross-Origin-Resource-Policy": "same-origin",
    "Referrer-Policy": "no-referrer",
    "X-Content-Type-Options": "nosniff",
}
RAW_SECURITY_HEADERS = [(name.lower().encode(), value.encode()) for name, value in SECURITY_HEADERS.items()]
# Where the name of the caller's key stands in a request's scope.
_CLIENT = "cspace.client"
# A client alone gets FACTOR of FACTOR + 1 parts; the more clients there are, the less each.
FACTOR = 3
_FOREIGN_SITES = (b"cross-site", b"same-site")
# What one subscriber is usually given of IPv6; single addresses of it are free to choose.
_SUBSCRIBER_BITS = 64
# RFC 6052: a translator's clients, each with its IPv4 address in the last 32 bits.
_NAT64 = ipaddress.IPv6Network("64:ff9b::/96")
# Of a Content-Length, without leading zeros: Python turns at most some thousand digits into a number.
_MAX_DIGITS = 30

Full = Literal["server", "client"]


def add_limits(app: FastAPI, protection: Protection) -> None:
    """Puts the limits before an app; what is added last is asked first.

    Raises:
        ConfigError: the file of keys is not one.
    """
    keys = None
    if protection.keys_file is not None:
        keys = ApiKeys.read(protection.keys_file)
        warn_of_readers(protection.keys_file)
    app.add_middleware(Limits, protection=protection, keys=keys)
    if protection.origins:
        app.add_middleware(
            CORSMiddleware,
            allow_origins=protection.origins,
            allow_methods=["GET", "POST"],
            allow_headers=["*"],
            expose_headers=["*"],
        )
    app.add_middleware(Doors, hosts=protection.hosts, origins=protection.origins)
    if protection.trusted_proxies:
        app.add_middleware(ProxyHeadersMiddleware, trusted_hosts=list(protection.trusted_proxies))


def is_watching(scope: Scope) -> bool:
    """Whether a request only watches the server, which matters most when it is overloaded."""
    return scope["path"] in HEALTH or scope["path"] == METRICS


def client_of(scope: Scope) -> str:
    """By whom requests are counted: the name of the key, else the peer's address, of IPv6 the first half."""
    if _CLIENT in scope:
        return f"key {scope[_CLIENT]}"
    return f"peer {_subscriber((scope.get('client') or ('unknown', 0))[0])}"


@lru_cache(maxsize=4096)
def _subscriber(host: str) -> str:
    """The address, of IPv6 the first half; an IPv4 address inside one of IPv6 counts as itself."""
    try:
        address = ipaddress.ip_address(host.partition("%")[0])
    except ValueError:
        return host
    if isinstance(address, ipaddress.IPv6Address):
        if address in _NAT64:
            return str(ipaddress.IPv4Address(int(address) & 0xFFFFFFFF))
        # Mapped, or tunnelled (6to4, with 65536 halves each).
        inner = address.ipv4_mapped or address.sixtofour
        return str(inner or ipaddress.ip_network((int(address), _SUBSCRIBER_BITS), strict=False))
    return str(address)


class Shares:
    """Places of which each client may hold at most ``FACTOR`` times as many as are free.

    The bound of dynamic queue thresholds (Choudhury and Hahne 1998): whoever takes much leaves little free,
    and thereby lowers his own bound, so some places stay for who comes next. No lock: one event loop uses it.

    Args:
        limit: places in all, at least 1.
    """

    def __init__(self, limit: int) -> None:
        self.limit = limit
        self.free = limit
        self._held: defaultdict[str, int] = defaultdict(int)

    def take(self, client: str, amount: int = 1) -> Full | None:
        """Takes places, all or none, at least 1; returns what is full, or None."""
        if amount > self.free:
            return "server"
        if self._held.get(client, 0) >= FACTOR * self.free:
            return "client"
        self.free -= amount
        self._held[client] += amount
        return None

    def give(self, client: str, amount: int = 1) -> None:
        """Gives places back."""
        self.free += amount
        self._held[client] -= amount
        if not self._held[client]:
            del self._held[client]


def overloaded(full: Full, what: str, limit: int) -> RequestError:
    """The error for who got no place; it says when to ask again."""
    if full == "server":
        detail = f"the server is full: {limit} {what} are all that it takes"
    else:
        detail = f"this client's share of the server's {limit} {what} is full; others still find room"
    return RequestError(
        OVERLOADED,
        detail,
        remedy=f"ask again after {RETRY_AFTER_S} s, and from fewer places at once",
        headers={"Retry-After": str(RETRY_AFTER_S)},
    )


class TokenBuckets:
    """One bucket a client: full at first, a token a request, refilled evenly.

    Args:
        rate_per_s: tokens that come back each second, above 0.
        burst: tokens that a bucket holds.
        capacity: how many clients are remembered; the one that asked longest ago is forgotten first.
        clock: seconds, monotonic.
    """

    def __init__(
        self,
        rate_per_s: float,
        burst: int,
        *,
        capacity: int = MAX_CLIENTS,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self._rate_per_s, self._burst, self._clock = rate_per_s, burst, clock
        # What each holds, and since when.
        self._buckets: MutableMapping[str, tuple[float, float]] = LRUCache(capacity)

    def __len__(self) -> int:
        return len(self._buckets)

    def take(self, client: str) -> float:
        """Takes a token; 0.0, or without one the time in s until there is one."""
        now = self._clock()
        held, then = self._buckets.get(client, (float(self._burst), now))
        held = min(self._burst, held + (now - then) * self._rate_per_s)
        wait_s = 0.0 if held >= 1.0 else (1.0 - held) / self._rate_per_s
        self._buckets[client] = (held - 1.0 if wait_s == 0.0 else held, now)
        return wait_s


class Doors:
    """Answers 421 to unknown hosts and 403 to the pages of other sites; health pages are open to all.

    A page of any site makes its visitor's browser ask servers on loopback; one whose name is made to mean
    127.0.0.1 (DNS rebinding) even reads the answers. Both show in headers that no page can forge.

    Args:
        app: what is protected.
        hosts: names besides those of loopback, without port; ``*`` for any.
        origins: of other sites, as ``https://host:port``.
    """

    def __init__(self, app: ASGIApp, hosts: Iterable[str] = (), origins: Iterable[str] = ()) -> None:
        self._app = app
        self._any = ANY in hosts
        self._hosts = frozenset(name.lower().encode() for name in (*LOOPBACK_NAMES, *hosts))
        self._origins = frozenset(origin.lower().encode() for origin in origins)

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Passes a request on, or refuses it."""
        if scope["type"] != "http" or scope["path"] in HEALTH:
            await self._app(scope, receive, send)
            return
        found = dict(scope["headers"])
        hosts = [value for name, value in scope["headers"] if name == b"host"]
        if len(scope.get("raw_path") or b"") + len(scope.get("query_string", b"")) > MAX_TARGET_BYTES:
            response = problem_response(
                URI_TOO_LONG,
                f"path and query are longer than {MAX_TARGET_BYTES} bytes",
                remedy="send values in the body",
            )
        elif (
            len(scope["headers"]) > MAX_HEADERS
            or sum(len(name) + len(value) for name, value in scope["headers"]) > MAX_HEADER_BYTES
        ):
            response = problem_response(
                HEADERS_TOO_LARGE,
                f"more than {MAX_HEADERS} headers, or than {MAX_HEADER_BYTES} bytes of them",
                remedy="send fewer and shorter headers",
            )
        elif len(hosts) != 1 or not self._knows(hosts[0]):
            response = problem_response(
                UNKNOWN_HOST,
                "the server does not answer under this name",
                expected="one Host header with a name that the server knows",
                remedy="ask for localhost, or have the server's CSPACE_API_HOSTS name the host",
            )
        elif self._is_foreign(scope, found):
            response = problem_response(
                FOREIGN_ORIGIN,
                "the request comes from a page of another site",
                remedy="have the server's CSPACE_API_ORIGINS name the page's origin",
            )
        else:
            await self._app(scope, receive, send)
            return
        await response(scope, receive, send)

    def _knows(self, host: bytes) -> bool:
        if self._any:
            return bool(host)
        end = host.find(b":", host.find(b"]") + 1)
        return (host if end < 0 else host[:end]).lower() in self._hosts

    def _is_foreign(self, scope: Scope, found: dict[bytes, bytes]) -> bool:
        origin = found.get(b"origin")
        if origin is not None:
            own = scope["scheme"].encode() + b"://" + found[b"host"]
            return origin.lower() != own.lower() and origin.lower() not in self._origins
        if found.get(b"sec-fetch-site") not in _FOREIGN_SITES:
            return False
        # A link to a page of this server: the visitor leaves the other site.
        return not (scope["method"] == "GET" and found.get(b"sec-fetch-mode") == b"navigate")


class Limits:
    """Asks for keys, and bounds the rate, the requests in flight, and the bodies of each client.

    A single client is refused earlier than all together, so that its slow requests leave places for others.
    Health pages and metrics are neither counted nor refused.

    Args:
        app: what is protected.
        protection: the settings.
        keys: the known ones; None lets everybody in.
    """

    def __init__(self, app: ASGIApp, protection: Protection, keys: ApiKeys | None = None) -> None:
        self._app, self._keys, self._body_timeout_s = app, keys, protection.body_timeout_s
        rate_per_s = protection.rate_per_s
        self._buckets = TokenBuckets(rate_per_s, protection.rate_burst) if rate_per_s > 0 else None
        self._places = Shares(protection.max_in_flight)
        self._held = Shares(protection.held_body_bytes)

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Passes a request on, or refuses it."""
        if scope["type"] != "http":
            await self._app(scope, receive, send)
            return
        try:
            self._check_key(scope)
            if is_watching(scope):
                await self._app(scope, receive, send)
                return
            client = client_of(scope)
            self._check_rate(client)
            _check_announced(scope)
            full = self._places.take(client)
            if full is not None:
                raise overloaded(full, "requests in flight", self._places.limit)
        except RequestError as error:
            await request_problem(error)(scope, receive, send)
            return
        body = _CountedBody(receive, client, self._held, self._body_timeout_s)
        try:
            await self._app(scope, body.receive, body.closing(send))
        finally:
            self._places.give(client)
            if body.size:
                self._held.give(client, body.size)

    def _check_key(self, scope: Scope) -> None:
        path = scope["path"]
        if self._keys is None or path in HEALTH or path == "/" or path.startswith(f"{WORKBENCH_FILES}/"):
            return
        token = bearer_token(Headers(scope=scope).getlist("authorization"))
        name = None if token is None else self._keys.name_of(token)
        if name is None:
            challenge = REALM if token is None else f'{REALM}, error="invalid_token"'
            raise RequestError(
                UNAUTHORIZED,
                "this server answers callers with an API key only",
                expected="Authorization: Bearer KEY",
                # What came is not repeated: it may be a key with one letter wrong.
                got="no key" if token is None else "an unknown key",
                remedy="ask whoever runs the server for a key",
                headers={"WWW-Authenticate": challenge},
            )
        scope[_CLIENT] = name
        record = request_record.get()
        if record is not None:
            record.client = name

    def _check_rate(self, client: str) -> None:
        wait_s = 0.0 if self._buckets is None else self._buckets.take(client)
        if wait_s > 0.0:
            seconds = math.ceil(wait_s)
            raise RequestError(
                TOO_MANY_REQUESTS,
                "this client asks more often than it may",
                remedy=f"ask again after {seconds} s",
                headers={"Retry-After": str(seconds)},
            )


class _CountedBody:
    """The body of one request: its size, its part of what all bodies may hold, and its time.

    The time runs from the headers to the last byte, so a byte now and then does not lengthen it.
    """

    def __init__(self, receive: Receive, client: str, held: Shares, limit_s: float) -> None:
        self.size = 0
        self._receive, self._client, self._held, self._limit_s = receive, client, held, limit_s
        self._until = asyncio.get_running_loop().time() + limit_s
        self._complete, self._late = False, False

    async def receive(self) -> Message:
        """The next piece; raises RequestError where it is too large, too late, or too much for all."""
        if self._complete:
            return await self._receive()
        try:
            async with asyncio.timeout_at(self._until):
                message = await self._receive()
        except TimeoutError:
            self._late = True
            raise RequestError(
                REQUEST_TIMEOUT,
                "the body did not arrive in time",
                expected=f"all of it within {self._limit_s:g} s",
                remedy="send it again, over a faster connection or as a smaller picture",
            ) from None
        self._complete = message["type"] != "http.request" or not message.get("more_body", False)
        size = len(message.get("body", b""))
        if self.size + size > MAX_BODY_BYTES:
            raise _too_large(f"more than {MAX_BODY_BYTES} bytes")
        if size:
            full = self._held.take(self._client, size)
            if full is not None:
                raise overloaded(full, "bytes of bodies", self._held.limit)
            self.size += size
        return message

    def closing(self, send: Send) -> Send:
        """``send``, which ends the connection of a body that came too late."""

        async def closing(message: Message) -> None:
            if self._late and message["type"] == "http.response.start":
                message["headers"] = [*message.get("headers", ()), (b"connection", b"close")]
            await send(message)

        return closing


def _check_announced(scope: Scope) -> None:
    announced = dict(scope["headers"]).get(b"content-length", b"0").lstrip(b"0")[:_MAX_DIGITS]
    if announced.isdigit() and int(announced) > MAX_BODY_BYTES:
        raise _too_large(f"{int(announced)} bytes")


def _too_large(got: str) -> RequestError:
    return RequestError(
        BODY_TOO_LARGE,
        "the body is too large",
        expected=f"at most {MAX_BODY_BYTES} bytes",
        got=got,
        remedy="send a smaller picture; 2048 pixels a side are the most that is accepted",
    )
