"""How long each step of a request took by itself, without the steps that it called."""

import functools
import time
from collections import defaultdict
from contextvars import ContextVar
from typing import Any


class Spans:
    """The steps of one request.

    Args:
        own: step to the seconds that it took without the steps inside it.
    """

    def __init__(self) -> None:
        self.own: dict[str, float] = defaultdict(float)
        # Name, and seconds that steps inside took.
        self._open: list[tuple[str, list[float]]] = []

    def begin(self, name: str) -> float:
        """Go into a step; when that was."""
        self._open.append((name, [0.0]))
        return time.perf_counter()

    def end(self, began: float) -> None:
        """Leave the innermost step."""
        taken = time.perf_counter() - began
        name, (inside,) = self._open.pop()
        self.own[name] += taken - inside
        if self._open:
            self._open[-1][1][0] += taken


# Handed on to the thread that computes, for a thread's work runs in a copy of its caller's context.
request: ContextVar[Spans | None] = ContextVar("request", default=None)


def wrap(owner: Any, attribute: str, name: str) -> None:
    """Measure each call of a function in a request as a step."""
    inner = getattr(owner, attribute)

    @functools.wraps(inner)
    def measured(*arguments, **named):
        spans = request.get()
        if spans is None:
            return inner(*arguments, **named)
        began = spans.begin(name)
        try:
            return inner(*arguments, **named)
        finally:
            spans.end(began)

    setattr(owner, attribute, measured)


def wrap_coroutine(owner: Any, attribute: str, name: str) -> None:
    """As :func:`wrap` for a coroutine function; what it waits for counts."""
    inner = getattr(owner, attribute)

    @functools.wraps(inner)
    async def measured(*arguments, **named):
        spans = request.get()
        if spans is None:
            return await inner(*arguments, **named)
        began = spans.begin(name)
        try:
            return await inner(*arguments, **named)
        finally:
            spans.end(began)

    setattr(owner, attribute, measured)
