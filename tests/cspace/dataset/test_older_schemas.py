"""Data sets as earlier releases wrote them are read, with the digest that jobs remember them by."""

import json
from pathlib import Path

import numpy as np

from cspace.dataset import open_dataset
from cspace.dataset.manifest import Manifest
from cspace.worlds.planar.arm import PlanarArm
from cspace.worlds.planar.seeing.camera import Camera
from cspace.worlds.planar.world import PlanarWorld

# Written by 0.x before worlds had kinds: two scenarios, one joint with limits.
SCHEMA_1 = Path(__file__).with_name("schema_1")


def test_a_data_set_of_schema_1_is_one_of_the_planar_world():
    dataset = open_dataset(SCHEMA_1)
    arm = PlanarArm((1.5, 1.0), 0.1, (None, (-1.0, 2.0)))
    assert dataset.world == PlanarWorld(arm, Camera(pixels=16))
    assert (dataset.scenario_count, dataset.generator_seed, dataset.dim) == (2, 7, 2)
    assert [len(dataset.free_of(index)) for index in (0, 1)] == [3, 2]
    assert dataset.arrays["discs"].shape == (2, 3, 3)


def test_its_digest_is_the_one_that_it_was_written_with():
    written = json.loads((SCHEMA_1 / "manifest.json").read_text(encoding="utf-8"))
    assert open_dataset(SCHEMA_1).digest == written["digest"]


def test_written_again_it_names_its_world_and_keeps_its_digest(tmp_path):
    manifest = open_dataset(SCHEMA_1).manifest
    (tmp_path / "manifest.json").write_text(manifest.to_json(), encoding="utf-8")
    again = json.loads(manifest.to_json())
    assert (again["schema_version"], again["world"]["kind"]) == (2, "planar")
    assert "robot" not in again
    read = Manifest.read(tmp_path)
    assert (read.world, read.digest) == (manifest.world, manifest.digest)


def test_its_arrays_are_the_bytes_that_were_written():
    discs = np.load(SCHEMA_1 / "discs.npy")
    np.testing.assert_array_equal(open_dataset(SCHEMA_1).arrays["discs"], discs)
