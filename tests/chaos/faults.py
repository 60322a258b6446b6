"""Faults, each of which takes something away from a job under way and gives it back."""

import os
import random
import signal
import time
from collections.abc import Callable
from pathlib import Path

from tests.chaos.system import Driver, System

Fault = Callable[[System, Driver, random.Random], bool]

# How long a worker may take to appear after the moment that was drawn.
WORKER_S = 30.0


def kill_worker(system: System, driver: Driver, rng: random.Random) -> bool:
    """Kill -9 a process that trains."""
    until_s = time.monotonic() + WORKER_S
    for _ in driver.moments():
        workers = system.head.workers()
        if workers:
            rng.choice(workers).kill()
            return True
        if time.monotonic() > until_s:
            break
    return False


def kill_driver(system: System, driver: Driver, rng: random.Random) -> bool:
    """Kill -9 the driver."""
    del system, rng
    driver.send(signal.SIGKILL)
    return driver.wait() != 0


def stop_job(system: System, driver: Driver, rng: random.Random) -> bool:
    """Ask the driver to stop, as ``ray job stop`` does."""
    del system, rng
    driver.send(signal.SIGTERM)
    return driver.wait() != 0


def kill_server(system: System, driver: Driver, rng: random.Random) -> bool:
    """Kill -9 the tracking server and start it again half a minute later, whatever the job does meanwhile."""
    del rng
    alive = driver.process.poll() is None
    system.server.end(signal.SIGKILL)
    time.sleep(30.0)
    system.server.start()
    return alive


def kill_head(system: System, driver: Driver, rng: random.Random) -> bool:
    """The whole node goes, driver and all, and comes again."""
    del rng
    alive = driver.process.poll() is None
    system.head.kill()
    driver.send(signal.SIGKILL)
    driver.wait()
    system.head.start()
    return alive


def fill_disk(system: System, driver: Driver, rng: random.Random) -> bool:
    """No byte is free where jobs write, until the job has failed for it or 30 s have passed."""
    del rng
    alive = driver.process.poll() is None
    filler = system.data / "filler"
    fill(filler)
    try:
        until_s = time.monotonic() + 30.0
        for _ in driver.moments():
            if time.monotonic() > until_s:
                break
    finally:
        filler.unlink()
    return alive


def fill(path: Path) -> None:
    with path.open("wb") as file:
        size = 64 * 2**20
        while size:
            try:
                os.posix_fallocate(file.fileno(), file.seek(0, os.SEEK_END), size)
            except OSError:
                size //= 2
