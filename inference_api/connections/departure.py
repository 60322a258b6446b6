"""Word of a client that goes away, for requests that wait for their turn or take long."""

from collections.abc import Callable

# Where the departure of a request's client stands in its scope.
DEPARTURE = "cspace.departure"


class Departure:
    """Of one connection's client; on the event loop."""

    def __init__(self) -> None:
        self._leaving: dict[Callable[[], None], None] = {}
        self._is_gone = False

    def __call__(self, leave: Callable[[], None]) -> Callable[[], None]:
        """Have something called when the client goes away, at once if it has; what is returned ends that."""
        if self._is_gone:
            leave()
        else:
            self._leaving[leave] = None
        return lambda: self._leaving.pop(leave, None)

    def tell(self) -> None:
        """The client has gone away."""
        self._is_gone = True
        while self._leaving:
            self._leaving.popitem()[0]()
