"""Reading a ``.npy`` that somebody else wrote.

NumPy's own reader evaluates the header as a Python literal, which raises whatever a header likes and takes as
much memory. Files as NumPy writes them are read, and no others.
"""

import math
import re
from typing import Any

import numpy as np
from numpy.typing import NDArray

_HEADER = re.compile(
    rb"\{'descr': '([<|][a-z][0-9])', 'fortran_order': (True|False), 'shape': \(([0-9, ]{0,40})\), \} *\n"
)
_MAGIC = b"\x93NUMPY\x01\x00"
_LONGEST_HEADER = 512


def read_npy(data: bytes, types: tuple[str, ...], axes: int | tuple[int, ...]) -> NDArray[Any]:
    """An untrusted ``.npy`` file of version 1.0, whose header is matched and not evaluated.

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
