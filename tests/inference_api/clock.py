"""Time that passes when a test says so."""


class Clock:
    """Seconds, monotonic, from 100 on."""

    def __init__(self) -> None:
        self.now = 100.0

    def __call__(self) -> float:
        return self.now
