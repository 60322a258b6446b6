"""Progress of long work: a bar with an estimate on a terminal, plain lines in a log."""

import logging
import sys
import time
from types import TracebackType
from typing import Self

from tqdm import tqdm

_LOG = logging.getLogger("training")
LINE_EVERY_S = 2.0


class Progress:
    """Counts pieces of work that are done.

    Args:
        what: what is being done.
        total: pieces in all.
        unit: what a piece is.
    """

    def __init__(self, what: str, total: int, unit: str = "shard") -> None:
        self.what, self.total, self.done = what, total, 0
        self.started = self.told = time.monotonic()
        self.bar = tqdm(total=total, desc=what, unit=unit) if sys.stderr.isatty() else None

    def advance(self) -> None:
        """One more piece is done."""
        self.done += 1
        if self.bar is not None:
            self.bar.update()
            return
        now = time.monotonic()
        if now - self.told >= LINE_EVERY_S or self.done == self.total:
            self.told = now
            left = (now - self.started) / self.done * (self.total - self.done)
            _LOG.info("%s: %d/%d, %.0f s left", self.what, self.done, self.total, left)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self.bar is not None:
            self.bar.close()
