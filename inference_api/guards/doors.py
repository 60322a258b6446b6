"""ASGI middleware that asks under which name a request came, and from which site's page.

A page of any site makes its visitor's browser ask servers on loopback; one whose name is made to mean
127.0.0.1 (DNS rebinding) even reads the answers. Both tell on themselves by headers that no page can forge.
"""

from collections.abc import Iterable

from starlette.types import ASGIApp, Receive, Scope, Send

from inference_api.guards.names import ANY
from inference_api.page_names import is_health
from inference_api.problems import FOREIGN_ORIGIN, UNKNOWN_HOST, problem_response

LOOPBACK_NAMES = ("localhost", "127.0.0.1", "[::1]")
_ASKED = frozenset({b"host", b"origin", b"sec-fetch-site", b"sec-fetch-mode"})
_FOREIGN_SITES = (b"cross-site", b"same-site")


class Doors:
    """Answers 421 to unknown hosts and 403 to the pages of other sites; health pages are open to all.

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
        """Pass a request on, or refuse it."""
        if scope["type"] != "http" or is_health(scope):
            await self._app(scope, receive, send)
            return
        found: dict[bytes, bytes] = {}
        hosts = 0
        for name, value in scope["headers"]:
            if name in _ASKED:
                found[name] = value
                hosts += name == b"host"
        if hosts != 1 or not self._knows(found[b"host"]):
            response = problem_response(
                UNKNOWN_HOST,
                "the server does not answer under this name",
                expected="one Host header with a name that the server knows",
                remedy="ask for localhost, or have the server's CSPACE_API_HOSTS name the host",
            )
        elif len(found) > 1 and self._is_foreign(scope, found):
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
