"""Both HTTP clients behind one call."""

import anyio

from services.planner.sources.async_sampling_client import AsyncSamplingClient
from services.planner.sources.samples import SampleBatch
from services.planner.sources.sampling_client import SamplingClient

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
