"""Calls a function on untrusted files in a worker process, within limits of memory, time and output."""

import ctypes
import errno
import importlib
import json
import os
import resource
import signal
import subprocess
import sys
import threading
from collections.abc import Callable
from contextlib import suppress
from dataclasses import asdict, dataclass
from io import BufferedReader
from pathlib import Path
from typing import Any

from cspace import errors
from cspace.errors import CspaceError, ServiceError

# For the interpreter and the libraries to be there, on a busy machine.
START_S = 60.0
# What an interpreter needs; passwords and addresses are none of a file's business.
_ENVIRONMENT = (
    "PATH",
    "HOME",
    "LANG",
    "LC_ALL",
    "LD_LIBRARY_PATH",
    "TMPDIR",
    "VIRTUAL_ENV",
    "NUMBA_CACHE_DIR",
)
_SETTINGS = {
    "OMP_NUM_THREADS": "1",
    "OPENBLAS_NUM_THREADS": "1",
    "ORT_DISABLE_TELEMETRY": "1",
    "MPLBACKEND": "agg",
}
_STARTED = b"started\n"
_PRINTED_BYTES = 2**20
_DIE_WITH_PARENT = 1  # PR_SET_PDEATHSIG


@dataclass(frozen=True, slots=True)
class Limits:
    """What a worker may take: memory beyond its libraries, time of a core and by the clock, a file's size."""

    memory_bytes: int = 2**30
    cpu_s: int = 60
    wall_s: float = 120.0
    file_bytes: int = 0
    open_files: int = 64

    def __str__(self) -> str:
        memory_mib = self.memory_bytes // 2**20
        return f"at most {memory_mib} MiB of memory, {self.cpu_s} s of a core and {self.wall_s:g} s"


def call(
    function: Callable[..., Any],
    *arguments: Any,
    limits: Limits,
    what: str,
    error: type[CspaceError],
    remedy: str | None = None,
) -> Any:
    """The function's result, of arguments that JSON can hold; what it prints is printed here, up to a MiB."""
    environment = {name: os.environ[name] for name in _ENVIRONMENT if name in os.environ} | _SETTINGS
    environment["PYTHONPATH"] = os.pathsep.join(place for place in sys.path if place)
    main = sys.modules["__main__"].__spec__
    module = main.name if function.__module__ == "__main__" and main else function.__module__
    job = json.dumps([module, function.__qualname__, arguments, asdict(limits)]).encode()
    command = [sys.executable, "-P", "-m", "cspace.bounded_worker"]
    # Pipes: the limit of a file's size would hold for a log as well.
    with subprocess.Popen(
        command,
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        env=environment,
        process_group=0,
    ) as worker:
        assert worker.stdin and worker.stdout and worker.stderr  # noqa: S101, PT018 - for the type checker
        printing = threading.Thread(target=_print, args=(worker.stderr,), daemon=True)
        printing.start()
        timer = threading.Timer(START_S + limits.wall_s, worker.kill)
        timer.start()
        try:
            with suppress(BrokenPipeError), worker.stdin:
                worker.stdin.write(job)
            answer, status = worker.stdout.read(), worker.wait()
            printing.join(1.0)
        finally:
            timer.cancel()
            worker.kill()
    if not answer.startswith(_STARTED):
        raise ServiceError(f"{what} cannot be read: its process did not start", got=f"status {status}")
    found = json.loads(answer.removeprefix(_STARTED) or b"{}")
    if "result" in found:
        return found["result"]
    if "kind" in found:
        raise getattr(errors, found["kind"])(found["what"], **found["details"])
    got = {
        -signal.SIGXCPU: f"no end within {limits.cpu_s} s of a core",
        -signal.SIGALRM: f"no end within {limits.wall_s:g} s",
    }.get(
        status, found.get("limit", f"its process ended with status {status}, most likely for want of memory")
    )
    raise error(f"{what} needs more than it may have", expected=str(limits), got=got, remedy=remedy)


def _print(source: BufferedReader) -> None:
    left = _PRINTED_BYTES
    # Closed, where something that the worker started holds it longer.
    with suppress(ValueError, OSError):
        while chunk := source.read1():
            sys.stderr.write(chunk[:left].decode(errors="replace"))
            sys.stderr.flush()
            left -= len(chunk[:left])


def _limit_resources(limits: Limits) -> None:
    """Bound this process for good."""
    signal.signal(signal.SIGALRM, signal.SIG_DFL)
    signal.pthread_sigmask(signal.SIG_UNBLOCK, {signal.SIGALRM})
    held = int(Path("/proc/self/statm").read_text(encoding="ascii").split()[0]) * resource.getpagesize()
    wanted = {
        resource.RLIMIT_AS: held + limits.memory_bytes,
        resource.RLIMIT_CPU: int(resource.getrusage(resource.RUSAGE_SELF).ru_utime) + limits.cpu_s,
        resource.RLIMIT_FSIZE: limits.file_bytes,
        resource.RLIMIT_NOFILE: limits.open_files,
        resource.RLIMIT_CORE: 0,
    }
    for kind, value in wanted.items():
        _, hard = resource.getrlimit(kind)
        lower = value if hard == resource.RLIM_INFINITY else min(value, hard)
        resource.setrlimit(kind, (lower, hard if kind == resource.RLIMIT_CPU else lower))
    # Where a machine is full, this process goes and not its parent.
    with suppress(OSError):
        Path("/proc/self/oom_score_adj").write_text("1000", encoding="ascii")
    signal.setitimer(signal.ITIMER_REAL, limits.wall_s)


def _main() -> None:
    ctypes.CDLL(None).prctl(_DIE_WITH_PARENT, signal.SIGKILL)
    module, qualname, arguments, limits = json.load(sys.stdin)
    # Their memory is not the file's.
    function = getattr(importlib.import_module(module), qualname)
    with os.fdopen(os.dup(1), "wb") as results:
        os.dup2(2, 1)
        results.write(_STARTED)
        results.flush()
        _limit_resources(Limits(**limits))
        try:
            found = {"result": function(*arguments)}
        except CspaceError as problem:
            details = {"expected": problem.expected, "got": problem.got, "remedy": problem.remedy}
            found = {"kind": type(problem).__name__, "what": problem.what, "details": details}
        except ImportError as problem:
            details = {"got": f"no package {problem.name}", "remedy": f"pip install {problem.name}"}
            found = {"kind": "ServiceError", "what": "a library is missing", "details": details}
        except (MemoryError, RecursionError, OSError) as problem:
            if isinstance(problem, OSError) and problem.errno != errno.EFBIG:
                raise
            found = {"limit": str(problem) or type(problem).__name__}
        results.write(json.dumps(found).encode())
    os._exit(0)


if __name__ == "__main__":
    _main()
