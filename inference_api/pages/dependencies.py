"""What routes are given: the store of models, and where requests are computed and wait."""

from typing import Annotated

from fastapi import Depends, Request

from inference_api.models.store import ModelStore
from inference_api.turns.turns import Turns
from inference_api.turns.waiting_room import WaitingRoom


def store_of(request: Request) -> ModelStore:
    """The app's store of models."""
    store: ModelStore = request.app.state.store
    return store


def turns_of(request: Request) -> Turns:
    """The turns in which the app computes."""
    turns: Turns = request.app.state.turns
    return turns


def room_of(request: Request) -> WaitingRoom:
    """Where requests wait for models that have to be fetched."""
    room: WaitingRoom = request.app.state.room
    return room


# Asynchronous although they wait for nothing: plain functions would each be sent to a thread.
async def get_store(request: Request) -> ModelStore:
    """:func:`store_of` for routes."""
    return store_of(request)


async def get_turns(request: Request) -> Turns:
    """:func:`turns_of` for routes."""
    return turns_of(request)


async def get_room(request: Request) -> WaitingRoom:
    """:func:`room_of` for routes."""
    return room_of(request)


Store = Annotated[ModelStore, Depends(get_store)]
Turn = Annotated[Turns, Depends(get_turns)]
Room = Annotated[WaitingRoom, Depends(get_room)]
