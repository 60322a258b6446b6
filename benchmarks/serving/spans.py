"""How long each step of a request took by itself, without the steps that it called."""

import functools
import time
from collections import defaultdict
from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from typing import Any


class Spans:
    """The steps of one request.

    Args:
        own: step to the seconds that it took without the steps inside it.
    """

    def __init__(self) -> None:
        self.own: dict[str, float] = defaultdict(float)
        # For each step that is under way the seconds of the steps inside it.
        self.inside: list[float] = []


# Handed on to the thread that computes, for a thread's work runs in a copy of its caller's context.
request: ContextVar[Spans | None] = ContextVar("request", default=None)


@contextmanager
def step(name: str) -> Iterator[None]:
    """Measure a block as a step of the request that it belongs to, if it belongs to one."""
    spans = request.get()
    if spans is None:
        yield
        return
    spans.inside.append(0.0)
    began = time.perf_counter()
    try:
        yield
    finally:
        taken = time.perf_counter() - began
        spans.own[name] += taken - spans.inside.pop()
        if spans.inside:
            spans.inside[-1] += taken


def wrap(owner: Any, attribute: str, name: str) -> None:
    """Measure each call of a function as a step."""
    inner = getattr(owner, attribute)

    @functools.wraps(inner)
    def measured(*arguments, **named):
        with step(name):
            return inner(*arguments, **named)

    setattr(owner, attribute, measured)


def wrap_coroutine(owner: Any, attribute: str, name: str) -> None:
    """As :func:`wrap` for a coroutine function; what it waits for counts."""
    inner = getattr(owner, attribute)

    @functools.wraps(inner)
    async def measured(*arguments, **named):
        with step(name):
            return await inner(*arguments, **named)

    setattr(owner, attribute, measured)
