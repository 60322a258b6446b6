"""A test run that is asked to end by SIGTERM, as by ``timeout``, still ends the servers that it started."""

import os
import signal
from types import FrameType


def pytest_configure() -> None:
    """Let SIGTERM do to this process what an interrupt does; its forks end as they always did."""
    own = os.getpid()

    def end(number: int, frame: FrameType | None) -> None:
        del frame
        if os.getpid() == own:
            raise KeyboardInterrupt
        signal.signal(number, signal.SIG_DFL)
        signal.raise_signal(number)

    signal.signal(signal.SIGTERM, end)
