"""A run as a context manager, the same for all adapters."""

from abc import ABC, abstractmethod
from contextlib import suppress
from types import TracebackType
from typing import Self

from cspace.errors import RegistryError
from services.registry.tracking.port import RunStatus


class RunBlock(ABC):
    """Finishes the run when its block ends: FAILED by an exception, KILLED by an interrupt."""

    @abstractmethod
    def finish(self, status: RunStatus = "FINISHED") -> None:
        """End the run."""

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if kind is None:
            self.finish()
            return
        # The error that ended the block matters more than a server that is away or refuses as well.
        with suppress(RegistryError):
            self.finish("FAILED" if issubclass(kind, Exception) else "KILLED")
