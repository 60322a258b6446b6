"""Files that are not what a bundle's files are: too many, too large, links, pipes, bombs."""

import io
import os
import struct
import tracemalloc
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from cspace.bundle import Bundle, files
from cspace.errors import BundleIntegrityError
from tests.cspace.test_bundle_integrity import resign


def refused(folder: Path, match: str) -> None:
    """Within 60 MB."""
    tracemalloc.start()
    try:
        with pytest.raises(BundleIntegrityError, match=match) as caught:
            Bundle.load(folder)
        assert tracemalloc.get_traced_memory()[1] < 60e6
    finally:
        tracemalloc.stop()
    assert str(folder.parent) not in str(caught.value)
    assert len(str(caught.value)) < 2000


@pytest.mark.parametrize("name", ["bundle.json", "encoder.onnx"])
def test_a_file_that_is_too_large_is_not_read(folder: Path, name: str) -> None:
    with (folder / name).open("r+b") as file:
        # Sparse: it takes no room on the disk.
        file.truncate(files.LIMITS_BYTES[name] + 1)
    refused(folder, "more than")


@pytest.mark.timeout(10)
@pytest.mark.parametrize("name", ["SHA256SUMS", "generator.onnx"])
def test_a_pipe_is_refused_and_not_waited_for(folder: Path, name: str) -> None:
    (folder / name).unlink()
    os.mkfifo(folder / name)
    refused(folder, "not a plain file")
    (folder / name).unlink()
    (folder / name).mkdir()
    refused(folder, "not a plain file")


def put_golden(folder: Path, data: bytes) -> None:
    (folder / "golden.npz").write_bytes(data)
    resign(folder)


def arrays_of(folder: Path) -> dict[str, Any]:
    with np.load(folder / "golden.npz") as archive:
        return dict(archive)


def packed(arrays: dict[str, Any], **options: Any) -> bytes:
    """An archive as ``savez`` makes it, from arrays or from the bytes of entries."""
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w", zipfile.ZIP_DEFLATED, **options) as archive:
        for name, array in arrays.items():
            data = array
            if not isinstance(array, bytes):
                entry = io.BytesIO()
                np.save(entry, array)
                data = entry.getvalue()
            archive.writestr(f"{name}.npy", data)
    return buffer.getvalue()


def test_a_golden_case_that_unpacks_to_gigabytes_is_not_unpacked(folder: Path) -> None:
    header = b"\x93NUMPY\x01\x00"
    dictionary = b"{'descr': '<f4', 'fortran_order': False, 'shape': (50000000,), }\n"
    bomb = header + struct.pack("<H", len(dictionary)) + dictionary + bytes(200_000_000)
    data = packed({**arrays_of(folder), "mu": bomb})
    assert len(data) < 2**20
    put_golden(folder, data)
    refused(folder, "unpacked")


def change_golden(change: dict[str, Any]) -> Callable[[Path], bytes]:
    return lambda folder: packed(arrays_of(folder) | change)


GOLDEN: dict[str, Callable[[Path], bytes]] = {
    "a start of infinity": change_golden({"start": np.full(2, np.inf), "goal": np.zeros(2)}),
    "a picture of floats": change_golden({"image": np.zeros((48, 48, 3), np.float32)}),
    "a count of fractions": change_golden({"count": np.float64(2.5)}),
    "no seed": lambda folder: packed({k: v for k, v in arrays_of(folder).items() if k != "seed"}),
    "a torn end": lambda folder: packed(arrays_of(folder))[:-10],
}


@pytest.mark.parametrize("build", GOLDEN.values(), ids=GOLDEN)
def test_a_golden_case_that_cannot_be_is_refused(folder: Path, build: Callable[[Path], bytes]) -> None:
    put_golden(folder, build(folder))
    refused(folder, "golden case")
