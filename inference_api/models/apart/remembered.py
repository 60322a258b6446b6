"""A bounded memory of answers that hold for a while."""

import time
from collections import OrderedDict
from collections.abc import Callable, Hashable
from threading import Lock
from typing import Generic, TypeVar

_Key = TypeVar("_Key", bound=Hashable)
_Value = TypeVar("_Value")


class Remembered(Generic[_Key, _Value]):
    """Values by key, the least recently set dropped first; safe to share between threads.

    Args:
        capacity: how many.
        clock: seconds, monotonic.
    """

    def __init__(self, capacity: int, clock: Callable[[], float] = time.monotonic) -> None:
        self._capacity, self._clock = capacity, clock
        self._values: OrderedDict[_Key, tuple[_Value, float]] = OrderedDict()
        self._lock = Lock()

    def put(self, key: _Key, value: _Value, for_s: float) -> None:
        """Remember a value for so long."""
        with self._lock:
            self._values[key] = (value, self._clock() + for_s)
            self._values.move_to_end(key)
            while len(self._values) > self._capacity:
                self._values.popitem(last=False)

    def get(self, key: _Key) -> _Value | None:
        """A value that holds still, None without one."""
        with self._lock:
            value, until_s = self._values.get(key, (None, 0.0))
            return value if self._clock() < until_s else None

    def __len__(self) -> int:
        return len(self._values)
