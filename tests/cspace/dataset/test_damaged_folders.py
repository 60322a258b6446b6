import json
from pathlib import Path

import numpy as np
import pytest

from cspace.dataset import MANIFEST_FILE, Manifest, file_digest, open_dataset, write_dataset
from cspace.errors import DamagedFileError, DatasetError
from cspace.worlds.planar.arm import TWO_LINK
from cspace.worlds.planar.camera import Camera
from cspace.worlds.planar.world import PlanarWorld
from tests.dataset_content import content


def rewrite(folder: Path, **arrays):
    """Arrays changed by hand, with a manifest that fits them: only the format can be wrong."""
    manifest = Manifest.read(folder)
    files = dict(manifest.files)
    for name, array in arrays.items():
        np.save(folder / f"{name}.npy", array)
        files[f"{name}.npy"] = file_digest(folder / f"{name}.npy")
    rebuild(folder, manifest, files)


def rebuild(folder: Path, manifest: Manifest, files):
    changed = Manifest(manifest.world, manifest.counts, manifest.generator, files)
    (folder / MANIFEST_FILE).write_text(changed.to_json())


def edit(folder: Path, **values):
    path = folder / MANIFEST_FILE
    path.write_text(json.dumps(json.loads(path.read_text()) | values))


@pytest.fixture
def folder(tmp_path):
    return write_dataset(tmp_path / "data", **content()).folder


@pytest.mark.parametrize("name", ["free.npy", "extra_images.npy"])
def test_a_changed_byte_is_found_and_its_file_named(folder, name):
    data = bytearray((folder / name).read_bytes())
    data[-1] ^= 1
    (folder / name).write_bytes(data)
    with pytest.raises(DamagedFileError, match=f"{name} is damaged.*SHA-256"):
        open_dataset(folder)


def test_a_missing_file_is_named(folder):
    (folder / "collision.npy").unlink()
    with pytest.raises(DamagedFileError, match=r"collision\.npy is missing"):
        open_dataset(folder)


def test_a_changed_manifest_is_found(folder):
    edit(folder, world=PlanarWorld(TWO_LINK, Camera(pixels=17)).to_dict())
    with pytest.raises(DamagedFileError, match=r"manifest\.json is damaged"):
        open_dataset(folder)


@pytest.mark.parametrize("data", [b"", b"[]", b"[" * 100_000, b"\xff\xfe\x00"])
def test_a_manifest_that_is_no_json_object_is_an_error(folder, data):
    (folder / MANIFEST_FILE).write_bytes(data)
    with pytest.raises(DatasetError, match="manifest"):
        open_dataset(folder)


def test_a_folder_without_a_manifest_is_no_data_set(tmp_path):
    with pytest.raises(DatasetError, match=r"manifest\.json.*training.data import"):
        open_dataset(tmp_path)


def test_a_manifest_cannot_name_files_elsewhere(folder):
    outside = folder.parent / "outside.npy"
    np.save(outside, np.zeros(3))
    manifest = Manifest.read(folder)
    rebuild(folder, manifest, dict(manifest.files) | {"../outside.npy": file_digest(outside)})
    with pytest.raises(DatasetError, match="outside"):
        open_dataset(folder)


@pytest.mark.parametrize(
    ("arrays", "words"),
    [
        (
            {"images": np.zeros((3, 16, 16, 4), np.uint8)},
            r"images\.npy.*\(any, 16, 16, 3\).*\(3, 16, 16, 4\)",
        ),
        ({"images": np.zeros((3, 16, 16, 3), np.float32)}, r"images\.npy.*uint8.*float32"),
        ({"images": np.zeros((0, 16, 16, 3), np.uint8)}, r"images\.npy is empty"),
        ({"extra_images": np.zeros((2, 16, 15, 3), np.uint8)}, r"extra_images\.npy"),
        ({"free": np.zeros((10, 3), np.float32)}, r"free\.npy.*\(any, 2\).*\(10, 3\)"),
        ({"free": np.zeros((10, 2), np.float64)}, r"free\.npy.*float32.*float64"),
        ({"free": np.full((10, 2), np.nan, np.float32)}, r"free\.npy.*finite.*nan"),
        ({"free": np.full((10, 2), 3.2, np.float32)}, r"free\.npy.*\[-pi, pi\).*3\.2"),
        ({"free": np.full((10, 2), np.pi, np.float32)}, r"free\.npy"),
        ({"collision": np.full((3, 2), -3.2, np.float32)}, r"collision\.npy"),
        ({"free_offsets": np.array([0, 4, 4, 9])}, r"free_offsets\.npy.*0 to 10.*0 to 9"),
        ({"free_offsets": np.array([0, 6, 4, 10])}, r"free_offsets\.npy"),
        ({"free_offsets": np.array([0, 4, 10])}, r"free_offsets\.npy.*\(4\).*\(3,\)"),
        ({"free_offsets": np.array([0.0, 4.0, 4.0, 10.0])}, r"free_offsets\.npy.*int64"),
        ({"collision_offsets": np.array([0, 1, 3, 4])}, r"collision_offsets\.npy"),
        ({"path_offsets": np.array([0, 5, 8])}, r"path_offsets\.npy"),
        ({"path_scenario": np.array([0, 3])}, r"path_scenario\.npy.*0 to 2.*3"),
        ({"discs": np.ones((2, 3, 3))}, r"discs\.npy"),
        ({"discs": np.full((3, 3, 3), -1.0)}, r"discs\.npy.*radius|discs\.npy.*radii"),
        ({"notes": np.zeros(3)}, r"notes"),
    ],
)
def test_an_array_that_does_not_fit_is_named_with_what_was_expected(folder, arrays, words):
    rewrite(folder, **arrays)
    with pytest.raises(DatasetError, match=words):
        open_dataset(folder)
