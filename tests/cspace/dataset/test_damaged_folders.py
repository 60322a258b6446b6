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


OTHER_CAMERA = PlanarWorld(TWO_LINK, Camera(pixels=17)).to_dict()
DAMAGES = [
    (r"collision\.npy is missing", lambda folder: (folder / "collision.npy").unlink()),
    (r"manifest\.json is damaged", lambda folder: edit(folder, world=OTHER_CAMERA)),
    (r"manifest\.json.*training.data import", lambda folder: (folder / MANIFEST_FILE).unlink()),
    *(
        ("manifest", lambda folder, data=data: (folder / MANIFEST_FILE).write_bytes(data))
        for data in (b"", b"[]", b"[" * 100_000, b"\xff\xfe\x00")
    ),
]


@pytest.mark.parametrize(("words", "damage"), DAMAGES)
def test_a_missing_file_and_a_manifest_that_is_none_are_named(folder, words, damage):
    damage(folder)
    with pytest.raises(DatasetError, match=words):
        open_dataset(folder)


def test_a_manifest_cannot_name_files_elsewhere(folder):
    outside = folder.parent / "outside.npy"
    np.save(outside, np.zeros(3))
    manifest = Manifest.read(folder)
    rebuild(folder, manifest, dict(manifest.files) | {"../outside.npy": file_digest(outside)})
    with pytest.raises(DatasetError, match="outside"):
        open_dataset(folder)
