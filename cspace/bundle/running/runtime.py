"""onnxruntime, brought in when the first graph is opened and not before, with a limit of its memory.

Since 1.29 its official builds report on their use to their maker, from the import on, and keep an identifier
in the user's cache folder. This project sends nothing anywhere, so that is switched off in the only way that
comes in time: its environment variable, unless the user has set it.
"""

import os
import re
from contextlib import suppress
from functools import cache
from pathlib import Path
from typing import Any

# Of all sessions of a process together, weights aside; in a container at most this share of its limit.
ARENA_BYTES, CONTAINER_SHARE = 512 * 2**20, 0.5

_LONGEST = 300
_NO_LIMIT = 2**60
# The folders of a path, of whatever kind; its last part stays.
_FOLDERS = re.compile(r"(?:[A-Za-z]:)?(?:[\w.~+-]*[/\\])+")


@cache
def onnx_runtime() -> Any:
    """The module ``onnxruntime``."""
    os.environ.setdefault("ORT_DISABLE_TELEMETRY", "1")
    import onnxruntime  # noqa: PLC0415 - only after the variable is set

    return onnxruntime


@cache
def share_arena() -> None:
    """Give all sessions of this process one arena, which fails to grow beyond :data:`ARENA_BYTES`.

    A run that needs more raises. Without this each session has an arena of its own that grows without an end.
    """
    ort, container = onnx_runtime(), container_bytes()
    most = ARENA_BYTES if container is None else min(ARENA_BYTES, int(container * CONTAINER_SHARE))
    place = ort.OrtMemoryInfo("Cpu", ort.OrtAllocatorType.ORT_ARENA_ALLOCATOR, 0, ort.OrtMemType.DEFAULT)
    # Another thread, or whoever else uses onnxruntime here, may have come first.
    with suppress(*onnx_errors()):
        grows_as_asked = {"max_mem": most, "arena_extend_strategy": 1}
        ort.create_and_register_allocator(place, ort.OrtArenaCfg(grows_as_asked))


def container_bytes(root: Path = Path("/")) -> int | None:
    """The memory limit of the control groups that this process is in; None without one.

    Args:
        root: of the file system, for tests.
    """
    groups, lines = root / "sys/fs/cgroup", ""
    with suppress(OSError):
        lines = (root / "proc/self/cgroup").read_text(encoding="utf-8")
    files = {groups / "memory.max", groups / "memory/memory.limit_in_bytes"}
    for line in lines.splitlines():
        place = Path(line.rpartition(":")[2].lstrip("/"))
        files |= {groups / each / "memory.max" for each in (place, *place.parents)}
        files |= {groups / "memory" / each / "memory.limit_in_bytes" for each in (place, *place.parents)}
    found = []
    for file in files:
        with suppress(OSError, ValueError):
            found.append(int(file.read_text(encoding="ascii")))
    # The first version of control groups writes no limit as nearly 2^63.
    return min((limit for limit in found if limit < _NO_LIMIT), default=None)


@cache
def onnx_errors() -> tuple[type[Exception], ...]:
    """What onnxruntime raises; its exceptions share no base below Exception."""
    state = vars(onnx_runtime().capi.onnxruntime_pybind11_state)
    kinds = [kind for kind in state.values() if isinstance(kind, type) and issubclass(kind, Exception)]
    return (*kinds, RuntimeError, ValueError, MemoryError)


def said(error: BaseException) -> str:
    """What a library's error says, without folders of the machine and of a bounded length."""
    text = str(error) or type(error).__name__
    return _FOLDERS.sub("", text[: 4 * _LONGEST])[:_LONGEST]
