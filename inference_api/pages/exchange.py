"""From a request to its answer: parsed and computed in turns; a model that is not here is waited for apart.

A model that is at hand answers in the turn in which the request was read. One that is not is looked up and
loaded while nobody's turn is taken, in a waiting room of its own that is bounded, too.
"""

import asyncio
from collections.abc import Callable
from functools import partial
from typing import Protocol

from fastapi import Request
from fastapi.responses import Response

from inference_api.connections.departure import DEPARTURE
from inference_api.guards.rate import client_of
from inference_api.models.served import ServedModel
from inference_api.models.store import ModelStore
from inference_api.turns.turns import Turn, Turns
from inference_api.turns.waiting_room import WaitingRoom
from services.registry.references import ModelReference


class Question(Protocol):
    """A valid request."""

    @property
    def reference(self) -> ModelReference:
        """The model that it names."""

    def answer(self, served: ServedModel, turn: Turn) -> Response:
        """The answer of a model.

        Raises:
            CspaceError: as the contract's table of errors.
            ClientDisconnect: the client has gone away.
        """


async def respond(
    request: Request, store: ModelStore, turns: Turns, room: WaitingRoom, ask: Callable[[Turn], Question]
) -> Response:
    """The answer to a request.

    Args:
        request: whose body has been read.
        store: where the models are.
        turns: in which is computed.
        room: where is waited for models.
        ask: parses and validates in its turn; runs in a thread.

    Raises:
        CspaceError: as the contract's table of errors.
        ClientDisconnect: the client has gone away.
    """
    client = client_of(request.scope)
    watch = request.scope.get(DEPARTURE) or partial(_watch, request)

    def first(turn: Turn) -> Response | Question:
        question = ask(turn)
        served = store.resolve_now(question.reference)
        return question if served is None else question.answer(served, turn)

    found = await turns.run(first, client, watch)
    if isinstance(found, Response):
        return found
    served = await room.run(partial(store.resolve, found.reference), client)
    return await turns.run(partial(found.answer, served), client, watch)


def _watch(request: Request, leave: Callable[[], None]) -> Callable[[], None]:
    """By a task that waits for word of it; for servers that do not tell by themselves."""

    async def wait() -> None:
        # The body has been read, so that nothing else can come.
        while (await request.receive())["type"] != "http.disconnect":
            pass
        leave()

    waiting = asyncio.ensure_future(wait())

    def end() -> None:
        waiting.cancel()

    return end
