"""Reading a ``.npz`` that somebody else wrote: known arrays of bounded size, and nothing is evaluated."""

import io
import math
import re
import struct
import zipfile
import zlib
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cspace.errors import BundleIntegrityError

# Of one archive, unpacked; a picture of 2048 pixels has 12.6 MB.
MAX_BYTES = 32 * 2**20
_ENTRY = b"PK\x01\x02"
_HEADER = re.compile(
    rb"\{'descr': '([<|][a-z][0-9])', 'fortran_order': (True|False), 'shape': \(([0-9, ]{0,40})\), \} *\n"
)
_MAGIC = b"\x93NUMPY\x01\x00"
_LONGEST_HEADER = 512
_TORN = (
    zipfile.BadZipFile, zlib.error, struct.error, NotImplementedError, RuntimeError, EOFError, OSError,
    ValueError, OverflowError, KeyError, IndexError, MemoryError,
)  # fmt: skip


def read_arrays(
    data: bytes, allowed: Mapping[str, tuple[tuple[str, ...], int]], name: str
) -> dict[str, NDArray[Any]]:
    """The arrays of a ``.npz``.

    Args:
        data: its bytes.
        allowed: name to the types that it may have, as ``.npy`` writes them, and its number of axes.
        name: of the file, for messages.

    Raises:
        BundleIntegrityError: not such an archive, other arrays, or more than 32 MiB of them.
    """
    try:
        return _read(data, allowed)
    except _TORN as error:
        raise BundleIntegrityError(
            f"{name} is not a golden case",
            expected=f"the arrays {', '.join(allowed)} of at most {MAX_BYTES} bytes together",
            got=str(error)[:200] or type(error).__name__,
            remedy="export the bundle again",
        ) from error


def _read(data: bytes, allowed: Mapping[str, tuple[tuple[str, ...], int]]) -> dict[str, NDArray[Any]]:
    # Before any entry costs memory.
    if data.count(_ENTRY) > len(allowed):
        raise ValueError("more entries than there are arrays")
    arrays: dict[str, NDArray[Any]] = {}
    with zipfile.ZipFile(io.BytesIO(data)) as archive:
        entries = archive.infolist()
        if sum(entry.file_size for entry in entries) > MAX_BYTES:
            raise ValueError("more than that when it is unpacked")
        for entry in entries:
            name = entry.filename.removesuffix(".npy")
            if name not in allowed or name in arrays or not entry.filename.endswith(".npy"):
                raise ValueError(f"an entry {entry.filename[:40]!r}")
            if entry.flag_bits & 0x1 or entry.compress_type not in (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED):
                raise ValueError("an entry that is encrypted or packed in another way")
            with archive.open(entry) as file:
                arrays[name] = _array(file.read(entry.file_size), *allowed[name])
    return arrays


def _array(data: bytes, types: tuple[str, ...], axes: int) -> NDArray[Any]:
    """One array of a ``.npy`` file of version 1.0, whose header is matched and not evaluated."""
    start = len(_MAGIC) + 2
    length = int.from_bytes(data[len(_MAGIC) : start], "little")
    match = _HEADER.fullmatch(data, start, start + min(length, _LONGEST_HEADER))
    if not data.startswith(_MAGIC) or length > _LONGEST_HEADER or match is None:
        raise ValueError("an array with another header")
    descr = match[1].decode()
    shape = tuple(int(size) for size in match[3].decode().split(",") if size.strip())
    if descr not in types or len(shape) != axes:
        raise ValueError(f"an array of type {descr} and shape {shape}")
    kind = np.dtype(descr)
    if math.prod(shape) * kind.itemsize != len(data) - start - length:
        raise ValueError("an array whose shape does not fit its size")
    found = np.frombuffer(data, dtype=kind, offset=start + length)
    return found.reshape(shape, order="F" if match[2] == b"True" else "C")
