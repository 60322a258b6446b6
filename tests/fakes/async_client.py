"""The awaited client with the project's errors and queries, so that both clients meet the same tests."""

from typing import Any

import cspace_client
from services.planner.client import client_plan_query, client_sample_query, mapped


class AsyncSamplingClient(cspace_client.AsyncSamplingClient):
    async def answer(
        self, picture: Any, query: Any, model: str | None = None, robot: str | None = None
    ) -> Any:
        """Of the project's query."""
        with mapped():
            return await super().answer(picture, client_sample_query(query), model, query.robot)

    async def validity(self, *values: Any, **options: Any) -> Any:
        with mapped():
            return await super().validity(*values, **options)

    async def plan(self, picture: Any, query: Any, *values: Any, **options: Any) -> Any:
        with mapped():
            return await super().plan(picture, client_plan_query(query), *values, **options)
