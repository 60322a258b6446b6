"""How a test process ends."""

import atexit
import os
import sys

import pytest

_SESSION = pytest.StashKey[pytest.Session]()


def pytest_sessionstart(session: pytest.Session) -> None:
    """Keep the session, which will know what the tests came to."""
    session.config.stash[_SESSION] = session


@pytest.hookimpl(trylast=True)
def pytest_unconfigure(config: pytest.Config) -> None:
    """End a process that had Ray in it without taking the C++ libraries down.

    ``ray.shutdown`` leaves native threads (gRPC's, the core worker's) running. Once, after all tests had
    passed, a thread jumped into freed memory while the interpreter ended. What the tests came to stands then.
    """
    session = config.stash.get(_SESSION, None)
    if session is None or "ray._raylet" not in sys.modules or hasattr(config, "workerinput"):
        return
    atexit._run_exitfuncs()
    sys.stdout.flush()
    sys.stderr.flush()
    os._exit(int(session.exitstatus))
