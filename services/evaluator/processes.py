"""Draws of landmarks spread over processes, with the same numbers whatever their number."""

import multiprocessing
import os
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import ProcessPoolExecutor
from threading import Thread
from typing import Self, TypeVar

from cspace.errors import EvaluationError

Item = TypeVar("Item")
Result = TypeVar("Result")

# Work travels in this many parts a process, each with one copy of the points: few copies, even loads.
PARTS_PER_PROCESS = 4


def end_with_parent() -> None:
    """In a process of a pool: end when the process that made it has ended, in whatever way.

    A pool's processes wait for work, and of a parent that was killed nobody tells them.
    """
    parent = multiprocessing.parent_process()
    if parent is None:
        return

    def follow() -> None:
        parent.join()
        os._exit(1)

    Thread(target=follow, name="parent", daemon=True).start()


class ProcessMapper:
    """A ``map`` over a fixed number of processes, results in order; for ``mapper`` arguments.

    Processes start with the first call and serve all later ones; close the mapper, or use it in a ``with``.
    They are spawned, so a script that uses it needs the usual ``if __name__ == "__main__"``.

    Args:
        processes: one or more.

    Raises:
        EvaluationError: fewer than one process.
    """

    def __init__(self, processes: int) -> None:
        if processes < 1:
            raise EvaluationError("a mapper needs processes", expected="1 or more", got=str(processes))
        self.processes = processes
        context = multiprocessing.get_context("spawn")
        self._pool = ProcessPoolExecutor(processes, context, end_with_parent)

    def __call__(self, function: Callable[[Item], Result], items: Iterable[Item]) -> Iterator[Result]:
        """``map(function, items)``; the function and what it holds must pickle.

        Raises:
            Exception: whatever the function raised.
        """
        work = list(items)
        part = max(1, -(-len(work) // (self.processes * PARTS_PER_PROCESS)))
        return self._pool.map(function, work, chunksize=part)

    def close(self) -> None:
        """Ends the processes; twice is once."""
        self._pool.shutdown(cancel_futures=True)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()
