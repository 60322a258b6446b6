"""``numba.njit`` whose cache may be read only, and that compiles again when a called kernel changes."""

import hashlib
import pickle
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Any

import numba
import numba.core.caching

_caching: Any = numba.core.caching
# Numba looks at a kernel's own file alone, and so would keep what it calls in other files as it was.
_FILES = (path.read_bytes() for path in sorted(Path(__file__).parent.rglob("*.py")))
_SOURCES = hashlib.sha256(b"".join(data for data in _FILES if b"njit" in data)).hexdigest()
# A full disk leaves files that end too early, other versions name classes that have moved.
_UNREADABLE = (OSError, EOFError, ImportError, AttributeError, pickle.UnpicklingError)


def njit(**options: Any) -> Callable[[Callable[..., Any]], Any]:
    """``numba.njit`` with the cache of this module."""

    def compiled(function: Callable[..., Any]) -> Any:
        kernel: Any = numba.njit(**options | {"cache": False})(function)
        # Without a folder to write to, or where Numba is switched off, nothing is kept.
        with suppress(RuntimeError, AttributeError):
            kernel._cache = _Cache(kernel.py_func)  # noqa: SLF001 - where ``cache=True`` puts numba's own
        return kernel

    return compiled


class _ReadOnlyLocator(_caching.UserProvidedCacheLocator):  # type: ignore[misc]
    """``NUMBA_CACHE_DIR``, even where it cannot be written to."""

    def ensure_cache_path(self) -> None:
        with suppress(OSError):
            super().ensure_cache_path()


class _Parts(_caching.CompileResultCacheImpl):  # type: ignore[misc]
    _locator_classes = (_ReadOnlyLocator, _caching.InTreeCacheLocator, _caching.UserWideCacheLocator)


class _Cache(_caching.FunctionCache):  # type: ignore[misc]
    _impl_class = _Parts

    def _index_key(self, sig: Any, codegen: Any) -> tuple[Any, ...]:
        # Numba pickles what a closure holds, which for kernels differs from process to process.
        constants = {
            name: value
            for name, value in self._py_func.__globals__.items()
            if isinstance(value, bool | int | float)
        }
        return sig, codegen.magic_tuple(), _SOURCES, repr(constants), repr(_closure(self._py_func))

    def load_overload(self, sig: Any, target_context: Any) -> Any:
        with suppress(*_UNREADABLE):
            return super().load_overload(sig, target_context)
        # Else it would be read again before the next is saved.
        with suppress(*_UNREADABLE):
            self.flush()
        return None

    def save_overload(self, sig: Any, data: Any) -> None:
        with suppress(*_UNREADABLE):
            super().save_overload(sig, data)


def _closure(function: Any) -> list[Any]:
    """The names of kernels that a function's closure holds, with those that these hold, and other values."""
    held = [cell.cell_contents for cell in function.__closure__ or ()]
    return [
        (one.py_func.__module__, one.py_func.__qualname__, _closure(one.py_func))
        if hasattr(one, "py_func")
        else one
        for one in held
    ]
