"""Reading a ``.npy`` that somebody else wrote: bytes of a request or a bundle, or a file that is mapped."""

import math
import re
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cspace.errors import CspaceError

_HEADER = re.compile(
    rb"\{'descr': '([<|][a-z][0-9])', 'fortran_order': (True|False), 'shape': \(([0-9, ]{0,40})\), \} *\n"
)
_MAGIC = b"\x93NUMPY\x01\x00"
_LONGEST_HEADER = 512


def read_npy(data: bytes, types: tuple[str, ...], axes: int | tuple[int, ...]) -> NDArray[Any]:
    """An untrusted ``.npy`` file of version 1.0, as NumPy writes it.

    The header is matched: NumPy evaluates it as a Python literal, which takes time and memory of a server.

    Args:
        data: the file; the array shares its memory.
        types: that the array may have, as ``.npy`` writes them: ``<f4``.
        axes: number of the array's axes, or those that it may have.

    Raises:
        ValueError: it is no such file.
    """
    start = len(_MAGIC) + 2
    length = int.from_bytes(data[len(_MAGIC) : start], "little")
    match = _HEADER.fullmatch(data, start, start + min(length, _LONGEST_HEADER))
    if not data.startswith(_MAGIC) or length > _LONGEST_HEADER or match is None:
        raise ValueError("an array with another header")
    descr = match[1].decode()
    shape = tuple(int(size) for size in match[3].decode().split(",") if size.strip())
    if descr not in types or len(shape) not in ((axes,) if isinstance(axes, int) else axes):
        raise ValueError(f"an array of type {descr} and shape {shape}")
    kind = np.dtype(descr)
    if math.prod(shape) * kind.itemsize != len(data) - start - length:
        raise ValueError("an array whose shape does not fit its size")
    found = np.frombuffer(data, dtype=kind, offset=start + length)
    return found.reshape(shape, order="F" if match[2] == b"True" else "C")


def map_npy(path: Path, error: type[CspaceError]) -> NDArray[Any]:
    """A ``.npy`` file as a read-only array that is mapped, so that no shape is larger than its file.

    Args:
        path: of the file.
        error: what is raised.

    Raises:
        CspaceError: ``error``; it cannot be read, holds objects, or is no ``.npy`` file; an ``.npz`` is none.
    """
    try:
        mapped: NDArray[Any] = np.lib.format.open_memmap(path, mode="r")
    except Exception as problem:
        # All, for there is no list of what evaluating a header raises.
        got = str(problem)[:200] or type(problem).__name__
        raise error(f"{path} is no array", expected="a .npy file of numbers", got=got) from problem
    return mapped
