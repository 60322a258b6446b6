"""Files that are not what a bundle's files are: too many, too large, links, pipes, bombs."""

import contextlib
import io
import json
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
from cspace.bundle.golden import GoldenCase
from cspace.errors import BundleIntegrityError, StorageError
from tests.bundles import write_tiny_bundle
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


def test_files_that_are_too_large_together_are_not_read(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    whole = sum(path.stat().st_size for path in folder.iterdir())
    monkeypatch.setattr(files, "TOTAL_BYTES", whole - 1)
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


@pytest.mark.parametrize("name", ["SHA256SUMS", "golden.npz"])
def test_a_link_is_not_followed_even_to_the_right_bytes(folder: Path, name: str) -> None:
    (folder / name).rename(folder.parent / name)
    (folder / name).symlink_to(folder.parent / name)
    refused(folder, "not a plain file")


def test_a_link_that_is_put_in_place_after_the_look_is_not_followed(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    seen = os.scandir

    def then_exchanged(place: Any) -> Any:
        names = contextlib.nullcontext(list(seen(place)))
        target = folder / "encoder.onnx"
        target.rename(folder.parent / "encoder.onnx")
        target.symlink_to(folder.parent / "encoder.onnx")
        return names

    monkeypatch.setattr(os, "scandir", then_exchanged)
    refused(folder, "not a plain file")


def test_of_a_folder_full_of_files_one_is_enough(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for index in range(300):
        (folder / f"{index}.txt").touch()
    looked: list[str] = []
    real = os.scandir

    def counted(place: Any) -> Any:
        entries = list(real(place))
        return contextlib.nullcontext(looked.append(entry.name) or entry for entry in entries)  # type: ignore[func-returns-value]

    monkeypatch.setattr(os, "scandir", counted)
    refused(folder, "not part of a bundle")
    assert len(looked) <= len(files.LIMITS_BYTES) + 1


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


def test_a_directory_that_understates_its_entries_gives_no_more_than_it_says(folder: Path) -> None:
    data = packed({**arrays_of(folder), "mu": np.zeros(5_000_000, np.float32)})
    size = struct.pack("<I", 20_000_128)
    assert data.count(size) >= 1
    put_golden(folder, data.replace(size, struct.pack("<I", 100)))
    refused(folder, r"golden\.npz")


NPY = {
    "evaluated": b"{'descr': '<f4', 'fortran_order': False, 'shape': (4**9,), }",
    "a structure": b"{'descr': [('a', '<f4')], 'fortran_order': False, 'shape': (4,), }",
    "deep": b"{'descr': '<f4', 'fortran_order': False, 'shape': " + b"(" * 60000 + b", }",
    "huge": b"{'descr': '<f4', 'fortran_order': False, 'shape': (9999999999999999999,), }",
    "negative": b"{'descr': '<f4', 'fortran_order': False, 'shape': (-4,), }",
    "more than there is": b"{'descr': '<f4', 'fortran_order': False, 'shape': (5,), }",
}


@pytest.mark.parametrize("dictionary", NPY.values(), ids=NPY)
def test_an_array_with_another_header_is_refused_and_never_evaluated(folder: Path, dictionary: bytes) -> None:
    entry = b"\x93NUMPY\x01\x00" + struct.pack("<H", len(dictionary) + 1) + dictionary + b"\n" + bytes(16)
    put_golden(folder, packed({**arrays_of(folder), "mu": entry}))
    refused(folder, r"golden\.npz")


def change_golden(change: dict[str, Any]) -> Callable[[Path], bytes]:
    return lambda folder: packed(arrays_of(folder) | change)


GOLDEN: dict[str, Callable[[Path], bytes]] = {
    "twenty thousand and one": change_golden({"count": np.int64(20_001)}),
    "a thousand and one epsilons": change_golden({"epsilon_sigma": np.zeros(1001)}),
    "an epsilon that is none": change_golden({"epsilon_sigma": np.array([np.nan])}),
    "a start of infinity": change_golden({"start": np.full(2, np.inf), "goal": np.zeros(2)}),
    "a surprise": change_golden({"surprise": np.zeros(1)}),
    "a picture of floats": change_golden({"image": np.zeros((48, 48, 3), np.float32)}),
    "a count of fractions": change_golden({"count": np.float64(2.5)}),
    "no seed": lambda folder: packed({k: v for k, v in arrays_of(folder).items() if k != "seed"}),
    "many entries": lambda folder: packed({str(index): b"" for index in range(5000)}),
    "encrypted": lambda folder: _encrypted(packed(arrays_of(folder))),
    "a torn end": lambda folder: packed(arrays_of(folder))[:-10],
}


def _encrypted(data: bytes) -> bytes:
    changed = bytearray(data)
    at = data.index(b"PK\x01\x02")
    changed[at + 8] |= 1
    return bytes(changed)


@pytest.mark.parametrize("build", GOLDEN.values(), ids=GOLDEN)
def test_a_golden_case_that_cannot_be_is_refused(folder: Path, build: Callable[[Path], bytes]) -> None:
    put_golden(folder, build(folder))
    refused(folder, "golden case")


def test_an_array_in_columns_is_read_as_it_was_written(folder: Path) -> None:
    case = GoldenCase.from_npz((folder / "golden.npz").read_bytes())
    arrays = arrays_of(folder) | {"samples": np.asfortranarray(case.samples)}
    np.testing.assert_array_equal(GoldenCase.from_npz(packed(arrays)).samples, case.samples)


def _nested(values: dict[str, Any]) -> str:
    deep: Any = 0
    for _ in range(400):
        deep = {"a": deep}
    return json.dumps({**values, "provenance": {**values["provenance"], "config": deep}})


DESCRIPTIONS: dict[str, Callable[[dict[str, Any]], str]] = {
    "a latent of 10^5000": lambda values: json.dumps(values).replace(
        '"latent_dim": 4', '"latent_dim": 1' + "0" * 5000
    ),
    "a number of 10^400 elsewhere": lambda values: json.dumps(values).replace(
        '"samples_per_latent": 1', '"samples_per_latent": 1' + "0" * 400
    ),
    "quantiles without an end": lambda values: json.dumps(
        values | {"novelty_quantiles": [list(range(100_000))]}
    ),
    "a deep provenance": _nested,
    "half a character": lambda values: json.dumps(values).replace('"tests"', '"\\ud800"'),
    "a version as deep as it goes": lambda values: '{"schema_version": ' + "[" * 500 + "]" * 500 + "}",
    "many unknown keys": lambda values: json.dumps(values | {str(index): 0 for index in range(60_000)}),
}


@pytest.mark.parametrize("write", DESCRIPTIONS.values(), ids=DESCRIPTIONS)
def test_a_description_of_absurd_sizes_is_refused(
    folder: Path, write: Callable[[dict[str, Any]], str]
) -> None:
    path = folder / "bundle.json"
    path.write_text(write(json.loads(path.read_text())))
    resign(folder)
    refused(folder, r"descri|random input|bundle\.json")


def test_an_error_of_the_system_is_told_without_the_path(tmp_path: Path) -> None:
    with pytest.raises(BundleIntegrityError, match="No such file") as caught:
        Bundle.load(tmp_path / "nowhere")
    assert str(tmp_path) not in str(caught.value)
    (tmp_path / "file").write_text("")
    with pytest.raises(StorageError) as stored:
        write_tiny_bundle(tmp_path / "file" / "bundle")
    assert str(tmp_path) not in str(stored.value)
