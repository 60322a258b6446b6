"""onnxruntime, brought in when the first graph is opened and not before.

Since 1.29 its official builds report on their use to their maker, from the import on, and keep an identifier
in the user's cache folder. This project sends nothing anywhere, so that is switched off in the only way that
comes in time: its environment variable, unless the user has set it.
"""

import os
import re
from functools import cache
from typing import Any

_LONGEST = 300
# The folders of a path, of whatever kind; its last part stays.
_FOLDERS = re.compile(r"(?:[A-Za-z]:)?(?:[\w.~+-]*[/\\])+")


@cache
def onnx_runtime() -> Any:
    """The module ``onnxruntime``."""
    os.environ.setdefault("ORT_DISABLE_TELEMETRY", "1")
    import onnxruntime  # noqa: PLC0415 - only after the variable is set

    return onnxruntime


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
