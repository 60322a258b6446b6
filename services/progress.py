"""Progress of long work: a bar with an estimate on a terminal, plain lines in a log."""

import sys
import time
from collections.abc import Callable
from typing import Self

from tqdm import tqdm

LINE_EVERY_S = 5.0


class Progress:
    """Counts pieces of work that are done.

    Args:
        what: is being done.
        total: pieces in all.
        show: takes the lines where there is no terminal.
        unit: what a piece is.
    """

    def __init__(self, what: str, total: int, show: Callable[[str], None], unit: str = "run") -> None:
        self._what, self._total, self._done, self._show = what, total, 0, show
        self._began = self._told = time.monotonic()
        self._bar = tqdm(total=total, desc=what, unit=unit) if sys.stderr.isatty() else None

    def advance(self) -> None:
        """One more piece is done."""
        self._done += 1
        if self._bar is not None:
            self._bar.update()
            return
        now = time.monotonic()
        if now - self._told >= LINE_EVERY_S or self._done == self._total:
            self._told = now
            left_s = (now - self._began) / self._done * (self._total - self._done)
            self._show(f"{self._what}: {self._done}/{self._total}, {left_s:.0f} s left")

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        if self._bar is not None:
            self._bar.close()
