"""Reading a ``.npz`` that somebody else wrote: known arrays of bounded size, and nothing is evaluated."""

import io
import struct
import zipfile
import zlib
from collections.abc import Mapping
from typing import Any

from numpy.typing import NDArray

from cspace.errors import BundleIntegrityError
from cspace.files import read_npy

# Of one archive, unpacked; a picture of 2048 pixels has 12.6 MB.
MAX_BYTES = 32 * 2**20
# Types, and number of axes.
Allowed = tuple[tuple[str, ...], int | tuple[int, ...]]
_ENTRY = b"PK\x01\x02"
_TORN = (
    zipfile.BadZipFile, zlib.error, struct.error, NotImplementedError, RuntimeError, EOFError, OSError,
    ValueError, OverflowError, KeyError, IndexError, MemoryError,
)  # fmt: skip


def read_arrays(data: bytes, allowed: Mapping[str, Allowed], name: str) -> dict[str, NDArray[Any]]:
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


def _read(data: bytes, allowed: Mapping[str, Allowed]) -> dict[str, NDArray[Any]]:
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
                arrays[name] = read_npy(file.read(entry.file_size), *allowed[name])
    return arrays
