"""The awaited client with the project's errors and sources, so that both clients meet the same tests."""

from typing import Any

import cspace_client
from services.planner.client import client_plan_query, mapped


class AsyncSamplingClient(cspace_client.AsyncSamplingClient):
    def __init__(self, url: str, *values: Any, **options: Any) -> None:
        with mapped():
            super().__init__(url, *values, **options)

    async def answer(self, *values: Any, **options: Any) -> Any:
        with mapped():
            return await super().answer(*values, **options)

    async def validity(self, *values: Any, **options: Any) -> Any:
        with mapped():
            return await super().validity(*values, **options)

    async def plan(self, picture: Any, query: Any, *values: Any, **options: Any) -> Any:
        with mapped():
            return await super().plan(picture, client_plan_query(query), *values, **options)

    async def sample(self, *values: Any, **options: Any) -> Any:
        with mapped():
            return await super().sample(*values, **options)
