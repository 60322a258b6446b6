"""What routes are given: the store of models and the limit on simultaneous sampling."""

from typing import Annotated

from anyio import CapacityLimiter
from fastapi import Depends, Request

from inference_api.model_store import ModelStore


# Asynchronous although they wait for nothing: plain functions would each be sent to a thread.
async def get_store(request: Request) -> ModelStore:
    """The app's store of models."""
    store: ModelStore = request.app.state.store
    return store


async def get_limiter(request: Request) -> CapacityLimiter:
    """The app's limit on requests that are computed at the same time."""
    limiter: CapacityLimiter = request.app.state.limiter
    return limiter


Store = Annotated[ModelStore, Depends(get_store)]
Limiter = Annotated[CapacityLimiter, Depends(get_limiter)]
