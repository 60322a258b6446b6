"""Progress of long work: a bar with an estimate on a terminal, plain lines in a log."""

import math
import sys
import time
from collections.abc import Callable
from typing import Self

from tqdm import tqdm

LINE_EVERY_S = 5.0
# A pace is worth telling after this long.
_KNOWN_AFTER_S = 2.0
_SOON_S = 5.0


class Estimate:
    """How long work will still take, by its pace since the beginning."""

    def __init__(self, total: int, done: int = 0, clock: Callable[[], float] = time.monotonic) -> None:
        self._total, self._first, self._clock, self._began = total, done, clock, clock()

    def left(self, done: int) -> str:
        """What is left after so many pieces, after a comma; empty while nobody knows, and at the end."""
        passed, made = self._clock() - self._began, done - self._first
        if made < 1 or passed < _KNOWN_AFTER_S or done >= self._total:
            return ""
        return time_left(passed / made * (self._total - done))


def time_left(seconds: float | None) -> str:
    """A time in round words after a comma, never zero; empty for None."""
    if seconds is None:
        return ""
    if seconds < _SOON_S:
        return ", almost done"
    if seconds <= 60:
        return f", about {5 * math.ceil(seconds / 5)} s left"
    if seconds < 5400:
        return f", about {math.ceil(seconds / 60)} min left"
    return f", about {seconds / 3600:.1f} h left"


class Progress:
    """Counts pieces of work that are done."""

    def __init__(self, what: str, total: int, show: Callable[[str], None], unit: str = "run") -> None:
        self._what, self._total, self._done, self._show = what, total, 0, show
        self._estimate, self._shown_at = Estimate(total), time.monotonic()
        shape = f"{{desc}}: {{percentage:3.0f}}%|{{bar}}| {{n_fmt}}/{{total_fmt}} {unit}s{{postfix}}"
        self._bar = tqdm(total=total, desc=what, bar_format=shape) if sys.stderr.isatty() else None

    def advance(self) -> None:
        """One more piece is done."""
        self._done += 1
        left = self._estimate.left(self._done)
        if self._bar is not None:
            self._bar.set_postfix_str(left.removeprefix(", "), refresh=False)
            self._bar.update()
            return
        now = time.monotonic()
        if now - self._shown_at >= LINE_EVERY_S or self._done == self._total:
            self._shown_at = now
            self._show(f"{self._what}: {self._done}/{self._total}{left}")

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        if self._bar is not None:
            self._bar.close()
