"""``njit`` with a cache that never makes a call fail and never serves code of another version.

Numba's own cache raises where its folder cannot be written. It also looks at a kernel's own file alone, so a
kernel that calls one of another file stays as it was when that file changes. Here a kernel is read from
``NUMBA_CACHE_DIR`` even where that is read only, one that cannot be saved stays in memory, and one is
compiled again when anything that it is made of has changed.
"""

import hashlib
import pickle
from collections.abc import Callable
from contextlib import suppress
from typing import Any

import numba
import numba.core.caching
import numba.core.dispatcher
import numpy as np

# Half of what is needed of numba here has no types.
_caching: Any = numba.core.caching
_Dispatcher: Any = numba.core.dispatcher.Dispatcher
_settings: Any = numba.config
# A full disk leaves files that end too early.
_UNREADABLE = (OSError, EOFError, pickle.UnpicklingError)
_CONSTANTS = (bool, int, float, str, tuple, np.ndarray)


def njit(**options: Any) -> Callable[[Callable[..., Any]], Any]:
    """``numba.njit`` of the same options, with the cache of this module."""

    def compiled(function: Callable[..., Any]) -> Any:
        kernel: Any = numba.njit(**options | {"cache": False})(function)
        if isinstance(kernel, _Dispatcher):
            kernel._cache = KernelCache(function)  # noqa: SLF001 - where ``cache=True`` puts numba's own
        return kernel

    return compiled


class _Locator:
    """Where a function's kernels lie: the first folder that can be written, else the first one, to read."""

    def __init__(self, function: Callable[..., Any], file: str) -> None:
        usual = (_caching.InTreeCacheLocator, _caching.UserWideCacheLocator)
        kinds = (_caching.UserProvidedCacheLocator,) if _settings.CACHE_DIR else usual
        writable = (kind.from_function(function, file) for kind in kinds)
        place = next((one for one in writable if one is not None), None) or kinds[0](function, file)
        self._stamp = _stamp(function, place.get_source_stamp())
        self.get_cache_path = place.get_cache_path
        self.get_disambiguator = place.get_disambiguator
        self.ensure_cache_path = place.ensure_cache_path

    @classmethod
    def from_function(cls, function: Callable[..., Any], file: str) -> "_Locator":
        """As numba makes one."""
        return cls(function, file)

    def get_source_stamp(self) -> bytes:
        """What the function is compiled from."""
        return self._stamp


class _CacheParts(_caching.CompileResultCacheImpl):  # type: ignore[misc]
    _locator_classes = (_Locator,)


class KernelCache(_caching.FunctionCache):  # type: ignore[misc]
    """Numba's cache of one function; a disk that is full, damaged or read only keeps nothing."""

    _impl_class = _CacheParts

    def __init__(self, function: Callable[..., Any]) -> None:
        super().__init__(function)
        held = [cell.cell_contents for cell in function.__closure__ or ()]
        self._held = hashlib.sha256(b"\n".join(_part(one) for one in held)).digest()

    def _index_key(self, sig: Any, codegen: Any) -> tuple[Any, ...]:
        # Numba's own pickles what a closure holds, which for kernels differs from process to process.
        return sig, codegen.magic_tuple(), self._held

    def load_overload(self, sig: Any, target_context: Any) -> Any:
        """What was saved; None where there is nothing that can be read."""
        with suppress(*_UNREADABLE):
            return super().load_overload(sig, target_context)
        return None

    def save_overload(self, sig: Any, data: Any) -> None:
        """Save what was compiled, where that is possible."""
        with suppress(*_UNREADABLE):
            super().save_overload(sig, data)

    @property
    def stamp(self) -> bytes:
        """Of all that the function is compiled from."""
        return bytes(self._impl.locator.get_source_stamp()) + self._held


def _part(value: Any) -> bytes:
    """What stands for a kernel or a constant of another function."""
    if isinstance(value, _Dispatcher) and isinstance(value._cache, KernelCache):  # noqa: SLF001
        return value._cache.stamp  # noqa: SLF001
    return repr(value).encode()


def _stamp(function: Callable[..., Any], source: bytes) -> bytes:
    """Of a function's file, and of the kernels and constants that stand in its module."""
    parts = {source}
    for name, value in function.__globals__.items():
        if isinstance(value, _Dispatcher):
            parts.add(_part(value))
        elif isinstance(value, _CONSTANTS) and not name.startswith("__"):
            parts.add(f"{name}={value!r}".encode())
    return hashlib.sha256(b"\n".join(sorted(parts))).digest()
