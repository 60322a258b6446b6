"""ASGI middleware that asks for an API key."""

from starlette.datastructures import Headers
from starlette.types import ASGIApp, Receive, Scope, Send

from inference_api.keys import ApiKeys
from inference_api.page_names import is_open
from inference_api.problems import UNAUTHORIZED, problem_response
from inference_api.record import note_client

# Where the name of the caller's key stands in a request's scope.
CLIENT = "cspace.client"
REALM = 'Bearer realm="cspace-sampler"'


class Authentication:
    """Answers 401 to a request without a known key; health and the workbench's files need none.

    Args:
        app: what is protected.
        keys: the known ones.
    """

    def __init__(self, app: ASGIApp, keys: ApiKeys) -> None:
        self._app = app
        self._keys = keys

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Pass a request on under the name of its key."""
        if scope["type"] == "lifespan" or (scope["type"] == "http" and is_open(scope)):
            await self._app(scope, receive, send)
            return
        token = bearer_token(Headers(scope=scope).getlist("authorization"))
        name = None if token is None else self._keys.name_of(token)
        if name is not None:
            scope[CLIENT] = name
            note_client(name)
            await self._app(scope, receive, send)
            return
        challenge = REALM if token is None else f'{REALM}, error="invalid_token"'
        response = problem_response(
            UNAUTHORIZED,
            "this server answers callers with an API key only",
            expected="Authorization: Bearer KEY",
            # What came is not repeated: it may be a key with one letter wrong.
            got="no key" if token is None else "an unknown key",
            remedy="ask whoever runs the server for a key",
            headers={"WWW-Authenticate": challenge},
        )
        await response(scope, receive, send)


def bearer_token(headers: list[str]) -> str | None:
    """The token of the one ``Authorization`` header; None without one, with several, or in another scheme."""
    if len(headers) != 1:
        return None
    scheme, _, token = headers[0].strip().partition(" ")
    return token.strip() if scheme.lower() == "bearer" and token.strip() else None
