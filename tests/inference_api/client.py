"""A client of an app in this process: httpx over ASGI, the app's start and shutdown round it."""

from collections.abc import AsyncIterator, Callable, Coroutine, Iterable, Iterator
from contextlib import contextmanager
from functools import partial
from typing import Any

import httpx
from anyio.from_thread import BlockingPortal, start_blocking_portal
from fastapi import FastAPI


class ApiClient:
    """Sends requests to an app and waits for the answers."""

    def __init__(self, app: FastAPI, portal: BlockingPortal, client: httpx.AsyncClient) -> None:
        self.app = app
        self._portal = portal
        self._client = client

    def get(self, path: str, **options: Any) -> httpx.Response:
        """``GET path``."""
        return self._call(partial(self._client.get, path, **options))

    def post(self, path: str, **options: Any) -> httpx.Response:
        """``POST path``; an iterable ``content`` is sent in chunks, without a content length."""
        content = options.get("content")
        if content is not None and not isinstance(content, bytes | str):
            options["content"] = _chunks(content)
        return self._call(partial(self._client.post, path, **options))

    def options(self, path: str, **options: Any) -> httpx.Response:
        """``OPTIONS path``."""
        return self._call(partial(self._client.options, path, **options))

    def refresh(self) -> None:
        """Let the app look at its registry now instead of when its poll is due."""
        self.app.state.models.refresh()

    def _call(self, request: Callable[[], Coroutine[Any, Any, httpx.Response]]) -> httpx.Response:
        return self._portal.call(request)


@contextmanager
def running(app: FastAPI) -> Iterator[ApiClient]:
    """Start an app, hand out its client, shut it down."""
    transport = httpx.ASGITransport(app, raise_app_exceptions=False)
    client = httpx.AsyncClient(transport=transport, base_url="http://localhost")
    with (
        start_blocking_portal() as portal,
        portal.wrap_async_context_manager(app.router.lifespan_context(app)),
        portal.wrap_async_context_manager(client),
    ):
        yield ApiClient(app, portal, client)


async def _chunks(parts: Iterable[bytes]) -> AsyncIterator[bytes]:
    for part in parts:
        yield part
