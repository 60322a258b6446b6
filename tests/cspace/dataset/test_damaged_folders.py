import json
from pathlib import Path

import numpy as np
import pytest

from cspace.dataset import MANIFEST_FILE, Manifest, file_digest, open_dataset, write_dataset
from cspace.errors import DatasetError
from cspace.worlds.planar.arm import TWO_LINK
from cspace.worlds.planar.camera import Camera
from cspace.worlds.planar.world import PlanarWorld
from tests.dataset_content import content


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
    with pytest.raises(DatasetError, match=f"{name} is damaged.*SHA-256"):
        open_dataset(folder)


def test_a_missing_file_is_named(folder):
    (folder / "collision.npy").unlink()
    with pytest.raises(DatasetError, match=r"collision\.npy is missing"):
        open_dataset(folder)


def test_a_changed_manifest_is_found(folder):
    edit(folder, world=PlanarWorld(TWO_LINK, Camera(pixels=17)).to_dict())
    with pytest.raises(DatasetError, match=r"manifest\.json is damaged"):
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
