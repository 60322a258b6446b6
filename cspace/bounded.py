"""Calls a function on what a stranger sent, in a worker process that the kernel bounds.

Descriptions of robots, meshes, recordings and bundles are read here. Their readers then need no bounds of
their own: whatever a file makes them do ends at the limits of memory, time and output. ``python -m
cspace.bounded`` is the worker.
"""

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
from typing import Any, NoReturn, TextIO

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
_THREADS = {
    "OMP_NUM_THREADS": "1",
    "OPENBLAS_NUM_THREADS": "1",
    "ORT_DISABLE_TELEMETRY": "1",
    "MPLBACKEND": "agg",
}
_FIELDS = ("what", "expected", "got", "remedy")
_STARTED = b"started\n"
_PRINTED_BYTES = 2**20


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
    """The function's result; the first MiB of each stream that it prints is printed here."""
    environment = {name: os.environ[name] for name in _ENVIRONMENT if name in os.environ} | _THREADS
    environment["PYTHONPATH"] = os.pathsep.join(place for place in sys.path if place)
    name = f"{_module_of(function)}:{function.__qualname__}"
    reading, writing = os.pipe()
    command = [sys.executable, "-P", "-m", "cspace.bounded", name, json.dumps(asdict(limits)), str(writing)]
    try:
        with (
            os.fdopen(reading, "rb") as results,
            os.fdopen(writing, "wb") as theirs,
            subprocess.Popen(
                command,
                stdin=subprocess.PIPE,
                # Pipes: the limit of a file's size would hold for a log as well.
                stdout=subprocess.PIPE,
                stderr=subprocess.PIPE,
                env=environment,
                pass_fds=[writing],
                process_group=0,
            ) as worker,
        ):
            theirs.close()
            streams = ((worker.stdout, sys.stdout), (worker.stderr, sys.stderr))
            printing = [threading.Thread(target=_print, args=one, daemon=True) for one in streams]
            for one in printing:
                one.start()
            # It ends when its standard input does: with this process, however that ends.
            timer = threading.Timer(START_S + limits.wall_s, worker.kill)
            timer.start()
            try:
                assert worker.stdin is not None  # noqa: S101 - for the type checker
                with suppress(BrokenPipeError):
                    worker.stdin.write(json.dumps(arguments).encode() + b"\n")
                    worker.stdin.flush()
                answer = results.read()
                worker.wait()
                for one in printing:
                    one.join(1.0)
            finally:
                timer.cancel()
                worker.kill()
    except OSError as problem:
        raise ServiceError(f"{what} cannot be read: no process starts", got=problem.strerror) from None
    if not answer.startswith(_STARTED):
        raise ServiceError(
            f"{what} cannot be read: its process ended before it began", got=f"status {worker.returncode}"
        )
    return _result(answer[len(_STARTED) :], worker.returncode, limits, what, error, remedy)


def _print(source: BufferedReader, stream: TextIO) -> None:
    left = _PRINTED_BYTES
    # Closed, where something that it started holds it longer.
    with suppress(ValueError, OSError):
        while chunk := source.read1():
            stream.write(chunk[:left].decode(errors="replace"))
            stream.flush()
            left -= len(chunk[:left])


def _result(
    answer: bytes, status: int, limits: Limits, what: str, error: type[CspaceError], remedy: str | None
) -> Any:
    found: dict[str, Any] = json.loads(answer) if answer else {"limit": _limit_of(status, limits)}
    if "result" in found:
        return found["result"]
    if "kind" in found:
        kind: type[CspaceError] = getattr(errors, found["kind"])
        raise kind(found["what"], **{name: found[name] for name in _FIELDS[1:]})
    raise error(
        f"{what} needs more than it may have", expected=str(limits), got=found["limit"], remedy=remedy
    )


def _limit_of(status: int, limits: Limits) -> str:
    """The limit that ended a worker."""
    if status == -signal.SIGXCPU:
        return f"no end within {limits.cpu_s} s of a core"
    if status == -signal.SIGALRM:
        return f"no end within {limits.wall_s:g} s"
    return f"its process ended with status {status}, most likely for want of memory"


def _module_of(function: Callable[..., Any]) -> str:
    if function.__module__ != "__main__":
        return function.__module__
    spec = sys.modules["__main__"].__spec__
    assert spec is not None  # noqa: S101 - commands are run by python -m
    return spec.name


def _limit_resources(limits: Limits) -> None:
    """Bound this process for good."""
    # Ctrl-C is the parent's to handle.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
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


def _end_with_parent() -> None:
    sys.stdin.buffer.read()
    os._exit(1)


def _main(name: str, limits_json: str, results: str) -> NoReturn:
    module, _, qualname = name.partition(":")
    # Their memory is not the file's.
    function = getattr(importlib.import_module(module), qualname)
    arguments = json.loads(sys.stdin.buffer.readline())
    threading.Thread(target=_end_with_parent, daemon=True).start()
    with os.fdopen(int(results), "wb") as writing:
        writing.write(_STARTED)
        writing.flush()
        limits = Limits(**json.loads(limits_json))
        _limit_resources(limits)
        try:
            found = {"result": function(*arguments)}
        except CspaceError as problem:
            found = {"kind": type(problem).__name__, **{field: getattr(problem, field) for field in _FIELDS}}
        except (MemoryError, RecursionError) as problem:
            found = {"limit": f"{type(problem).__name__} beyond {limits.memory_bytes // 2**20} MiB"}
        except OSError as problem:
            if problem.errno != errno.EFBIG:
                raise
            found = {"limit": f"a file of more than {limits.file_bytes} bytes"}
        except ImportError as problem:
            found = {"kind": "ServiceError", "what": "a library is missing", "expected": None}
            found |= {"got": f"no package {problem.name}", "remedy": f"pip install {problem.name}"}
        sys.stdout.flush()
        writing.write(json.dumps(found).encode())
    os._exit(0)


if __name__ == "__main__":
    _main(*sys.argv[1:])
