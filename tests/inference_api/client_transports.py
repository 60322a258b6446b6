"""The Python clients' way into an app of this process."""

import anyio.to_thread
import httpx

from tests.inference_api.client import ApiClient


class IntoApp(httpx.BaseTransport, httpx.AsyncBaseTransport):
    """Hands every request to an app, whichever client sends it."""

    def __init__(self, api: ApiClient) -> None:
        self._api = api

    def handle_request(self, request: httpx.Request) -> httpx.Response:
        headers = dict(request.headers)
        answer = self._api.post(request.url.path, content=request.read(), headers=headers)
        return httpx.Response(answer.status_code, headers=answer.headers, content=answer.content)

    async def handle_async_request(self, request: httpx.Request) -> httpx.Response:
        content = await request.aread()
        forwarded = httpx.Request(request.method, request.url, headers=request.headers, content=content)
        return await anyio.to_thread.run_sync(self.handle_request, forwarded)
