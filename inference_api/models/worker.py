"""One worker process that asks the registry and downloads from it, so that MLflow is not in the server's.

A registry may trickle, lie or hang, which cannot be interrupted within a process. So every call has a
deadline: a worker that misses one is killed, and the next call starts another. Verification of a bundle has a
process of its own (:mod:`cspace.bundle.verification`).
"""

import json
import multiprocessing
import os
import re
import resource
import signal
import time
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import suppress
from functools import cache, partial
from itertools import count
from multiprocessing.connection import Connection
from pathlib import Path
from threading import Lock, Thread
from typing import Any, TypeVar

from pydantic import TypeAdapter, ValidationError
from pydantic_core import to_json

from cspace.errors import (
    CspaceError,
    ModelNotFoundError,
    RegistryError,
    RegistryUnavailableError,
    StorageError,
)
from inference_api.process import few_arenas
from services.registry.entities import ModelVersion
from services.registry.errors import anonymous, causes

LOOKUP_S, DOWNLOAD_S = 8.0, 90.0
# Imports on a busy machine take their time.
START_S = 60.0
# Between two starts of a process that fails again and again.
FIRST_PAUSE_S, LONGEST_PAUSE_S = 1.0, 30.0
# Of address space beyond the libraries, for lists and downloads.
MEMORY_BYTES = 512 * 2**20
FILE_BYTES, OPEN_FILES = 600 * 2**20, 256
# A list of some thousand versions with their decision logs.
MAX_REPLY_BYTES = 16 * 2**20
# More than a store has under way: each of its calls waits for a reply.
THREADS = 16
_END_S = 2.0
_SPAWN = multiprocessing.get_context("spawn")
_Found = TypeVar("_Found")
# What a reply may raise in the server. Replies are JSON: the process parses what a registry sends.
_ERRORS = {
    kind.__name__: kind
    for kind in (RegistryError, RegistryUnavailableError, ModelNotFoundError, StorageError, CspaceError)
}
_VERSION, _VERSIONS = TypeAdapter(ModelVersion), TypeAdapter(tuple[ModelVersion, ...])
_NAMES = TypeAdapter(tuple[str, ...])


class RegistryWorker:
    """A :class:`~services.registry.entities.ModelReader` in a worker process; safe to share by threads.

    Every method raises RegistryUnavailableError where the worker misses the deadline, dies or cannot start.

    Args:
        uri: of the tracking server.
        lookup_s: for one lookup.
        download_s: for one download.
    """

    def __init__(self, uri: str, lookup_s: float = LOOKUP_S, download_s: float = DOWNLOAD_S) -> None:
        self._uri, self._lookup_s, self._download_s = uri, lookup_s, download_s
        self._lock = Lock()
        self._process: _Process | None = None
        self._is_closed = False
        self._pause_s, self._resting_until_s = FIRST_PAUSE_S, 0.0

    @property
    def pid(self) -> int | None:
        """Of the process, None without one."""
        process = self._process
        return None if process is None else process.pid

    def start(self) -> None:
        """Start the process without waiting for it; the next call reports what fails."""
        self._is_closed = False
        with suppress(RegistryUnavailableError):
            self._running()

    def close(self) -> None:
        """End the process; a call that waits for it fails at once, as do later ones."""
        with self._lock:
            self._is_closed = True
            process, self._process = self._process, None
        if process is not None:
            process.end()

    def version(self, name: str, number: int) -> ModelVersion:
        """See :meth:`services.registry.entities.ModelReader.version`."""
        return self._look_up(_VERSION, "version", name, number)

    def by_alias(self, name: str, alias: str) -> ModelVersion:
        """See :meth:`services.registry.entities.ModelReader.by_alias`."""
        return self._look_up(_VERSION, "by_alias", name, alias)

    def versions(self, name: str) -> tuple[ModelVersion, ...]:
        """See :meth:`services.registry.entities.ModelReader.versions`."""
        return self._look_up(_VERSIONS, "versions", name)

    def names(self) -> tuple[str, ...]:
        """See :meth:`services.registry.entities.ModelReader.names`."""
        return self._look_up(_NAMES, "names")

    def download(self, version: ModelVersion, folder: Path) -> Path:
        """See :meth:`services.registry.entities.ModelReader.download`."""
        self._call(self._download_s, "download", version, folder.absolute())
        return folder

    def _look_up(self, kind: TypeAdapter[_Found], method: str, *arguments: Any) -> _Found:
        try:
            return kind.validate_json(self._call(self._lookup_s, method, *arguments))
        except ValidationError:
            raise RegistryError("the model registry answers what is no model version") from None

    def _call(self, limit_s: float, method: str, *arguments: Any) -> bytes:
        process = self._running()
        try:
            process.ready.result(START_S)
            found = process.submit(method, arguments).result(limit_s)
        except (TimeoutError, _EndedError) as error:
            with self._lock:
                if self._process is process:
                    self._process = None
                    self._resting_until_s = time.monotonic() + self._pause_s
                    self._pause_s = min(2.0 * self._pause_s, LONGEST_PAUSE_S)
            process.end()
            is_late = isinstance(error, TimeoutError)
            raise _unavailable("it takes too long" if is_late else "its process has ended", limit_s) from None
        self._pause_s = FIRST_PAUSE_S
        return found

    def _running(self) -> "_Process":
        with self._lock:
            if self._is_closed:
                raise _unavailable("the server is shutting down")
            if self._process is None or self._process.has_ended:
                if time.monotonic() < self._resting_until_s:
                    raise _unavailable("it has failed a moment ago")
                try:
                    self._process = _Process(self._uri)
                except (OSError, RuntimeError) as error:
                    raise _unavailable(f"no process can be started: {error}") from None
            return self._process


class _EndedError(Exception):
    """The worker process has ended before it replied."""


class _Process:
    """A running worker, and the calls that wait for its replies."""

    def __init__(self, uri: str) -> None:
        self._connection, theirs = _SPAWN.Pipe()
        # Not the server's child in everything: it stays when a terminal or a supervisor signals the group.
        self._process = _SPAWN.Process(target=_serve, args=(theirs, uri), name="registry", daemon=True)
        self._process.start()
        theirs.close()
        self.ready: Future[bytes] = Future()
        self._waiting: dict[int, Future[bytes]] | None = {0: self.ready}
        self._numbers, self._lock = count(1), Lock()
        self._reader = Thread(target=self._read, name="registry", daemon=True)
        self._reader.start()

    @property
    def pid(self) -> int | None:
        return self._process.pid

    @property
    def has_ended(self) -> bool:
        return self._waiting is None

    def submit(self, method: str, arguments: tuple[Any, ...]) -> Future[bytes]:
        """Send a call; the future raises the call's CspaceError, or _EndedError where no reply can come."""
        future: Future[bytes] = Future()
        with self._lock:
            if self._waiting is None:
                raise _EndedError
            number = next(self._numbers)
            self._waiting[number] = future
            with suppress(OSError):
                # A broken pipe: the reader is about to tell all that wait.
                self._connection.send((number, method, arguments))
        return future

    def end(self) -> None:
        """Kill the process and wait until it is gone."""
        self._process.kill()
        self._reader.join(_END_S)

    def _read(self) -> None:
        # Whatever else comes is no reply, and the process is ended as well.
        with suppress(EOFError, OSError, ValueError, KeyError, TypeError):
            while True:
                head, _, result = self._connection.recv_bytes(MAX_REPLY_BYTES).partition(b"\n")
                reply = json.loads(head)
                with self._lock:
                    future = self._waiting.pop(reply["number"]) if self._waiting else Future()
                if "what" in reply:
                    details = {name: reply[name] for name in ("expected", "got", "remedy")}
                    future.set_exception(_ERRORS[reply["kind"]](reply["what"], **details))
                else:
                    future.set_result(result)
        self._process.kill()
        self._process.join()
        with self._lock:
            waiting, self._waiting = self._waiting or {}, None
        for future in waiting.values():
            future.set_exception(_EndedError())


def _serve(connection: Connection, uri: str) -> None:
    """Run in the worker process: carry calls out side by side until the server is gone."""
    os.setpgid(0, 0)
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    few_arenas()
    # Libraries print the registry's address.
    nowhere = os.open(os.devnull, os.O_WRONLY)
    for stream in (1, 2):
        os.dup2(nowhere, stream)
    registry = _registry(uri)
    _limit_resources()
    sending = Lock()

    def reply(number: int, call: Callable[[], Any]) -> None:
        result, error = None, None
        try:
            result = call()
        except CspaceError as caught:
            error = _without_secrets(caught)
        except OSError as caught:
            error = StorageError("a file cannot be read or written", got=caught.strerror)
        except Exception as caught:  # noqa: BLE001 - whoever waits has to be told
            error = RegistryError("the model registry cannot be asked", got=type(caught).__name__)
        data = _reply(number, result, error)
        if len(data) > MAX_REPLY_BYTES:
            data = _reply(number, None, RegistryError("the model registry answers too much"))
        with sending:
            connection.send_bytes(data)

    reply(0, lambda: None)
    with ThreadPoolExecutor(THREADS) as pool:
        while True:
            try:
                number, method, arguments = connection.recv()
            except (EOFError, OSError):
                os._exit(0)
            pool.submit(reply, number, partial(_call, registry, method, arguments))


def _reply(number: int, result: Any, error: CspaceError | None) -> bytes:
    head: dict[str, int | str | None] = {"number": number}
    if error is not None:
        head["kind"] = next(kind.__name__ for kind in type(error).__mro__ if kind.__name__ in _ERRORS)
        head |= {name: getattr(error, name) for name in ("what", "expected", "got", "remedy")}
    return json.dumps(head).encode() + b"\n" + to_json(result)


def _registry(uri: str) -> Callable[[], Any]:
    from services.registry.errors import set_timeouts  # noqa: PLC0415 - MLflow takes seconds

    set_timeouts(os.environ)
    from services.registry.models import ModelRegistry  # noqa: PLC0415 - as above

    return cache(partial(ModelRegistry, uri))


def _call(registry: Callable[[], Any], method: str, arguments: tuple[Any, ...]) -> Any:
    return getattr(registry(), method)(*arguments)


def _limit_resources() -> None:
    """Bound address space, file size and open files of this process for good; no core files."""
    held = int(Path("/proc/self/statm").read_text(encoding="ascii").split()[0]) * resource.getpagesize()
    limits = {
        resource.RLIMIT_AS: held + MEMORY_BYTES,
        resource.RLIMIT_FSIZE: FILE_BYTES,
        resource.RLIMIT_NOFILE: OPEN_FILES,
        resource.RLIMIT_CORE: 0,
    }
    for kind, value in limits.items():
        _, hard = resource.getrlimit(kind)
        lower = value if hard == resource.RLIM_INFINITY else min(value, hard)
        resource.setrlimit(kind, (lower, lower))


def _without_secrets(error: CspaceError) -> CspaceError:
    """An error for clients and the log: no address, no path, and of what others wrote only the kind."""
    got = error.got
    if isinstance(error, RegistryError | StorageError) and error.__cause__ is not None:
        got = failure_of(error.__cause__)
    texts = {"expected": error.expected, "got": got, "remedy": error.remedy}
    clean = {name: None if text is None else anonymous(text) for name, text in texts.items()}
    return type(error)(anonymous(error.what), **clean)


def failure_of(error: BaseException) -> str:
    """The kinds of failure down to the cause, as ``ConnectionError, Connection refused``."""
    kinds: dict[str, None] = {}
    for one in causes(error):
        code, response = getattr(one, "error_code", None), getattr(one, "response", None)
        if isinstance(one, OSError) and one.errno:
            kinds[os.strerror(one.errno)] = None
        elif re.fullmatch(r"[A-Z][A-Z_]{0,40}", str(code)):
            kinds[str(code)] = None
        else:
            kinds[type(one).__name__] = None
        if isinstance(getattr(response, "status_code", None), int):
            kinds[f"status {response.status_code}"] = None  # type: ignore[union-attr]
    return ", ".join(kinds)


def _unavailable(got: str, limit_s: float | None = None) -> RegistryUnavailableError:
    return RegistryUnavailableError(
        "the model registry does not answer",
        expected=None if limit_s is None else f"an answer within {limit_s:g} s",
        got=got,
        remedy="ask again in some seconds",
    )
