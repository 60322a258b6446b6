"""A run that remembers what it is told, for tests of who tells it."""

from typing import Any, Self


class RecordingRun:
    """The part of a RunLog that a trial uses."""

    def __init__(self, run_id: str = "run") -> None:
        self.run_id = run_id
        self.rows: list[dict[str, float]] = []
        self.status: str | None = None

    def params(self, params: Any) -> None:
        """Nothing that a test looks at."""

    def history(self, rows: Any) -> None:
        """Keep rows."""
        self.rows += rows

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: object, trace: object) -> None:
        if kind is None:
            self.status = "FINISHED"
        else:
            self.status = "FAILED" if issubclass(kind, Exception) else "KILLED"
