"""Verifies bundles in a worker process with limits of time and memory.

A bundle's graphs may compute for hours or eat memory, and neither can be interrupted within a process. The
server, the commands on models, the evaluator and training verify what comes from a registry here before
anything of it runs in their own process. ``python -m cspace.bundle.verification`` is the worker.
"""

import json
import os
import resource
import signal
import subprocess
import sys
from contextlib import suppress
from pathlib import Path
from threading import Thread
from typing import Any, NoReturn

from cspace.bundle.load import Bundle
from cspace.bundle.runtime import container_bytes, onnx_runtime
from cspace.errors import BundleError, BundleIntegrityError, GoldenMismatchError, ServiceError

VERIFY_S = 30.0
# For the interpreter and the libraries to be there, on a busy machine.
START_S = 60.0
# Beyond what the worker holds with its libraries imported; in a container at most this share of its limit.
MEMORY_BYTES, CONTAINER_SHARE = 2**30, 0.25
OPEN_FILES = 64
# The worker's exit status where a library is missing, whose name it prints.
_NOT_INSTALLED = 3
MAX_ANSWER_BYTES = 64 * 2**10
_ERRORS = {kind.__name__: kind for kind in (BundleError, BundleIntegrityError, GoldenMismatchError)}
_FIELDS = ("what", "expected", "got", "remedy")
# What an interpreter needs; passwords of the registry and of its store are none of a bundle's business.
_ENVIRONMENT = ("PATH", "HOME", "LANG", "LC_ALL", "LD_LIBRARY_PATH", "TMPDIR", "VIRTUAL_ENV")


def verify(folder: Path, digest: str | None = None, limit_s: float = VERIFY_S) -> str:
    """Hold a bundle against its sums, its digest, the checks of its graphs and its golden case.

    Args:
        folder: of the bundle.
        digest: that it has to have; any when None.
        limit_s: for all of it, s.

    Returns:
        Its digest, for :meth:`cspace.bundle.Bundle.load` to open the same bundle without checking it again.

    Raises:
        BundleError: it is not sound, or needs more time or memory than it may have.
        ServiceError: the worker does not start, which says nothing of the bundle.
    """
    command = [
        sys.executable,
        "-m",
        "cspace.bundle.verification",
        str(folder.absolute()),
        digest or "",
        str(limit_s),
    ]
    environment = {name: os.environ[name] for name in _ENVIRONMENT if name in os.environ}
    environment |= {"OMP_NUM_THREADS": "1", "PYTHONSAFEPATH": "1", "ORT_DISABLE_TELEMETRY": "1"}
    environment["PYTHONPATH"] = os.pathsep.join(place for place in sys.path if place)
    try:
        # The worker ends when its standard input does: with this process, however that ends.
        with subprocess.Popen(
            command,
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            env=environment,
            process_group=0,
        ) as worker:
            try:
                worker.wait(START_S + limit_s)
            except subprocess.TimeoutExpired:
                worker.kill()
            answer = b"" if worker.stdout is None else worker.stdout.read(MAX_ANSWER_BYTES)
    except OSError as error:
        raise _not_verified(f"no process can be started: {error.strerror}") from None
    return _result(worker.returncode, answer, limit_s)


def load_verified(folder: Path, digest: str | None = None) -> Bundle:
    """Verify a bundle in a worker process, then open it here.

    Raises:
        BundleError: it is not sound, or has another digest.
        ServiceError: the worker does not start.
    """
    return Bundle.load(folder, digest=verify(folder, digest), check=False)


def _result(status: int, answer: bytes, limit_s: float) -> str:
    lines = answer.splitlines()
    if status == _NOT_INSTALLED:
        package = answer.decode()
        raise ServiceError(
            "the bundle cannot be verified", got=f"no package {package}", remedy=f"pip install {package}"
        )
    if not lines:
        raise _not_verified(f"its process ended with {status} before it began")
    found: dict[str, Any] = json.loads(lines[-1]) if len(lines) > 1 else {}
    if "digest" in found:
        return str(found["digest"])
    if found:
        kind = _ERRORS[found["kind"]]
        raise kind(found["what"], **{name: found[name] for name in _FIELDS[1:]})
    late = status in (-signal.SIGALRM, -signal.SIGKILL)
    raise BundleError(
        "the bundle does not stand its verification",
        expected=f"its golden case within {limit_s:g} s and {memory_bytes() // 2**20} MiB",
        got="it takes too long or too much" if late else f"its process ended with {status}",
        remedy="export the bundle again",
    )


def _not_verified(got: str) -> ServiceError:
    return ServiceError("the bundle cannot be verified", got=got, remedy="try again in some seconds")


def memory_bytes() -> int:
    """What a worker may take beyond its libraries."""
    container = container_bytes()
    return MEMORY_BYTES if container is None else min(MEMORY_BYTES, int(container * CONTAINER_SHARE))


def _limit_resources(limit_s: float) -> None:
    """Bound time, address space and files of this process for good; the kernel holds it to that."""
    # Ctrl-C is the parent's to handle.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.signal(signal.SIGALRM, signal.SIG_DFL)
    signal.pthread_sigmask(signal.SIG_UNBLOCK, {signal.SIGALRM})
    held = int(Path("/proc/self/statm").read_text(encoding="ascii").split()[0]) * resource.getpagesize()
    wanted = {
        resource.RLIMIT_AS: held + memory_bytes(),
        resource.RLIMIT_FSIZE: 0,
        resource.RLIMIT_NOFILE: OPEN_FILES,
        resource.RLIMIT_CORE: 0,
    }
    for kind, value in wanted.items():
        _, hard = resource.getrlimit(kind)
        lower = value if hard == resource.RLIM_INFINITY else min(value, hard)
        resource.setrlimit(kind, (lower, lower))
    # Where a container is full, this process goes and not the server.
    with suppress(OSError):
        Path("/proc/self/oom_score_adj").write_text("1000", encoding="ascii")
    signal.setitimer(signal.ITIMER_REAL, limit_s)


def _end_with_parent() -> None:
    sys.stdin.buffer.read()
    os._exit(1)


def _main(folder: str, digest: str, limit_s: str) -> NoReturn:
    # What a library prints must not get into the answer.
    answers = os.dup(sys.stdout.fileno())
    os.dup2(sys.stderr.fileno(), sys.stdout.fileno())
    Thread(target=_end_with_parent, daemon=True).start()
    try:
        import cspace.bundle.graph_check  # noqa: F401, PLC0415 - before the memory is bounded

        onnx_runtime()
    except ImportError as error:
        os.write(answers, str(error.name).encode())
        os._exit(_NOT_INSTALLED)
    os.write(answers, b"started\n")
    _limit_resources(float(limit_s))
    found: dict[str, str | None]
    try:
        found = {"digest": Bundle.load(Path(folder), digest=digest or None).digest}
    except BundleError as error:
        kind = next(kind.__name__ for kind in type(error).__mro__ if kind.__name__ in _ERRORS)
        found = {"kind": kind, **{name: getattr(error, name) for name in _FIELDS}}
    except (MemoryError, RecursionError) as error:
        found = {"kind": "BundleError", "what": "the bundle needs too much memory"}
        found |= {"expected": None, "got": type(error).__name__, "remedy": None}
    os.write(answers, json.dumps(found).encode())
    os._exit(0)


if __name__ == "__main__":
    _main(*sys.argv[1:])
