"""What a service is: how it is started, when it is ready, how it is ended."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path


@dataclass(frozen=True, slots=True)
class Service:
    """One process of the stack with its readiness.

    Args:
        name: short, for records and logs.
        title: for people.
        address: where it listens.
        port: of that address.
        setting: the environment variable that moves the port.
        command: makes the command line.
        environment: of the process.
        folder: that it runs in.
        ready: whether it does its work.
        start_limit_s: how long it may take until it is ready.
        stop_grace_s: how long it may take to end by itself.
        prepare: run before each start.
        interrupts: tells in lines which work its end would interrupt.
    """

    name: str
    title: str
    address: str
    port: int
    setting: str
    command: Callable[[], tuple[str, ...]]
    environment: Mapping[str, str]
    folder: Path
    ready: Callable[[], bool]
    start_limit_s: float
    stop_grace_s: float
    prepare: Callable[[], None] = lambda: None
    interrupts: Callable[[], Sequence[str]] = lambda: ()
