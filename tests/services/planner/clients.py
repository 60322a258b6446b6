"""Both HTTP clients behind one call."""

import anyio

from services.planner.client import SamplingClient
from services.planner.samples import SampleBatch
from tests.fakes.async_client import AsyncSamplingClient

KINDS = ("sync", "async")


def ask(
    kind: str, url: str, png: bytes, n: int, /, *, times: int = 1, options: dict, **question: object
) -> SampleBatch:
    """The answer to a question, the last one where it is asked several times.

    Args:
        kind: of client, one of ``KINDS``.
        options: of the client.
    """
    if kind == "sync":
        with SamplingClient(url, **options) as client:
            return [client.sample(png, n, **question) for _ in range(times)][-1]

    async def awaited() -> SampleBatch:
        async with AsyncSamplingClient(url, **options) as client:
            return [await client.sample(png, n, **question) for _ in range(times)][-1]

    return anyio.run(awaited)
