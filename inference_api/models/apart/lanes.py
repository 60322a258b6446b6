"""A few threads of the server's own for what may take long; none of them keeps the process from ending."""

from collections import deque
from collections.abc import Callable
from threading import Lock, Thread

Task = Callable[[], None]


class Lane:
    """One daemon thread that takes tasks in turn, and is there while there are some.

    Args:
        name: of the thread.
        limit: tasks that may wait.
    """

    def __init__(self, name: str, limit: int = 16) -> None:
        self._name, self._limit = name, limit
        self._tasks: deque[Task] = deque()
        self._lock = Lock()
        self._runs = False

    def put(self, task: Task, *, first: bool = False) -> bool:
        """Let a task be done, which must not raise.

        Args:
            task: what is to be done.
            first: before all that wait, and however many they are.

        Returns:
            Whether there was room for it.
        """
        with self._lock:
            if len(self._tasks) >= self._limit and not first:
                return False
            (self._tasks.appendleft if first else self._tasks.append)(task)
            if not self._runs:
                self._runs = True
                Thread(target=self._run, name=self._name, daemon=True).start()
        return True

    def _run(self) -> None:
        while True:
            with self._lock:
                if not self._tasks:
                    self._runs = False
                    return
                task = self._tasks.popleft()
            task()
