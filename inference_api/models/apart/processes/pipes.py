"""Lines over the pipes to a child, each with an absolute deadline."""

import os
import select
import time

from inference_api.models.apart.processes.wire import MAX_LINE_BYTES

_BLOCK_BYTES = 65536


class ChildError(Exception):
    """A child is late, dead, or answers what is no answer.

    Args:
        reason: in words of this project.
        at_work: whether it failed at the job itself, and not before.
    """

    def __init__(self, reason: str, *, at_work: bool) -> None:
        super().__init__(reason)
        self.at_work = at_work


def send(descriptor: int, line: bytes, until_s: float) -> None:
    """Write a line to a pipe that does not block.

    Args:
        descriptor: of the pipe.
        line: whole.
        until_s: of the monotonic clock.

    Raises:
        ChildError: nobody takes it in time, or ever.
    """
    rest = memoryview(line)
    try:
        while rest:
            _wait(descriptor, select.POLLOUT, until_s, at_work=False)
            rest = rest[os.write(descriptor, rest) :]
    except OSError:
        raise ChildError("its process has ended", at_work=False) from None


def receive(descriptor: int, until_s: float) -> bytes:
    """The next line, of whoever answers one line to each.

    Raises:
        ChildError: none comes in time, or ever, or it is too long.
    """
    line = bytearray()
    while not line.endswith(b"\n"):
        _wait(descriptor, select.POLLIN, until_s, at_work=True)
        try:
            block = os.read(descriptor, _BLOCK_BYTES)
        except OSError:
            block = b""
        if not block:
            raise ChildError("its process has ended", at_work=True)
        line += block
        if len(line) > MAX_LINE_BYTES:
            raise ChildError("it answers too much", at_work=True)
    return bytes(line)


def _wait(descriptor: int, event: int, until_s: float, *, at_work: bool) -> None:
    poll = select.poll()
    poll.register(descriptor, event)
    left_s = until_s - time.monotonic()
    if left_s <= 0.0 or not poll.poll(1e3 * left_s):
        raise ChildError("it takes too long", at_work=at_work)
