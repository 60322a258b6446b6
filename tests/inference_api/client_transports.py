"""The Python client's way into an app of this process."""

import httpx

from tests.inference_api.client import ApiClient


class IntoApp(httpx.BaseTransport):
    """Hands every request to an app."""

    def __init__(self, api: ApiClient) -> None:
        self._api = api

    def handle_request(self, request: httpx.Request) -> httpx.Response:
        headers = dict(request.headers)
        answer = self._api.post(request.url.path, content=request.read(), headers=headers)
        return httpx.Response(answer.status_code, headers=answer.headers, content=answer.content)
