import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from cspace.dataset import open_dataset, write_dataset
from cspace.dataset.manifest import MANIFEST_FILE, Manifest, file_digest
from cspace.errors import DamagedFileError, DatasetError
from cspace.worlds.planar.arm import THREE_LINK, TWO_LINK, PlanarArm
from cspace.worlds.planar.camera import Camera
from cspace.worlds.planar.world import PlanarWorld
from tests.dataset_content import CAMERA, SCENARIOS, content


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


@pytest.mark.parametrize("robot", [TWO_LINK, THREE_LINK, PlanarArm(joint_limits_rad=(None, (-1.0, 3.0)))])
def test_what_was_written_is_read_back(tmp_path, robot):
    values = content(robot)
    write_dataset(tmp_path / "deep" / "data", **values)
    dataset = open_dataset(tmp_path / "deep" / "data")
    assert (dataset.world, dataset.dim) == (PlanarWorld(robot, CAMERA), robot.dim)
    assert (dataset.scenario_count, dataset.generator_seed) == (SCENARIOS, 7)
    np.testing.assert_array_equal(dataset.images, values["images"])
    np.testing.assert_array_equal(dataset.extra_images, values["extra_images"])
    np.testing.assert_array_equal(dataset.arrays["discs"], values["scenes"]["discs"])
    for index in range(SCENARIOS):
        np.testing.assert_allclose(dataset.free_of(index), values["free"][index], atol=1e-6)
        np.testing.assert_allclose(dataset.collision_of(index), values["collision"][index], atol=1e-6)
    arrays = dataset.arrays
    assert arrays["path_offsets"].tolist() == [0, 5, 7]
    assert arrays["path_scenario"].tolist() == [2, 0]
    np.testing.assert_allclose(arrays["paths"], np.concatenate([p for _, p in values["paths"]]), atol=1e-6)


def test_only_pictures_and_free_configurations_are_needed(tmp_path):
    values = content(collision=None, paths=None, scenes=None, extra_images=None, generator={})
    dataset = write_dataset(tmp_path / "data", **values)
    assert (dataset.collision, dataset.collision_offsets, dataset.extra_images) == (None,) * 3
    assert "discs" not in dataset.arrays
    assert dataset.generator_seed is None
    with pytest.raises(DatasetError, match="no configurations in collision"):
        dataset.collision_of(0)


def test_a_data_set_without_a_single_collision_can_be_opened(tmp_path):
    none = [np.empty((0, 2))] * SCENARIOS
    dataset = write_dataset(tmp_path / "data", **content(collision=none, paths=[]))
    assert open_dataset(dataset.folder).collision_of(1).shape == (0, 2)


def test_configurations_outside_the_limits_are_refused(tmp_path):
    robot = PlanarArm(joint_limits_rad=((-4.0, 3.2), None))
    free = [np.array([[-3.9, 9.0], [3.2, 0.0]]), *[np.empty((0, 2))] * 2]
    stored = write_dataset(tmp_path / "data", **content(robot, free=free)).free_of(0)
    np.testing.assert_allclose(stored, [[-3.9, 9.0 - 2 * np.pi], [3.2, 0.0]], atol=1e-6)
    free[0][1, 0] = 3.3
    with pytest.raises(DatasetError, match="outside the robot's limits") as refused:
        write_dataset(tmp_path / "other", **content(robot, free=free))
    assert "3.3" in refused.value.got


def test_angles_are_wrapped_into_single_precision(tmp_path):
    free = [np.array([[np.pi, -np.pi], [7.0, 0.0]]), np.empty((0, 2)), np.empty((0, 2))]
    dataset = write_dataset(tmp_path / "data", **content(free=free))
    assert dataset.free.dtype == np.float32
    assert (np.asarray(dataset.free, dtype=np.float64) < np.pi).all()
    np.testing.assert_allclose(np.cos(dataset.free), np.cos(free[0]), atol=1e-6)


def test_arrays_are_mapped_and_read_only(folder):
    dataset = open_dataset(folder)
    assert isinstance(dataset.images, np.memmap)
    with pytest.raises(ValueError, match="read-only"):
        dataset.free[0] = 0.0


def test_equal_content_has_an_equal_digest_and_other_content_another(tmp_path):
    first, second, other, robot = (
        write_dataset(tmp_path / name, **values)
        for name, values in [
            ("a", content()),
            ("b", content(generator={"seed": 8})),
            ("c", content(seed=1)),
            ("d", content(PlanarArm((2.0, 1.9)))),
        ]
    )
    assert first.digest == second.digest
    assert len({first.digest, other.digest, robot.digest}) == 3


def test_the_manifest_counts_what_there_is(folder):
    counts = open_dataset(folder).manifest.counts
    assert (counts["images"], counts["free"], counts["collision"]) == (3, 10, 3)
    assert (counts["paths"], counts["extra_images"]) == (7, 2)


# Damage


@pytest.mark.parametrize("name", ["images.npy", "free.npy", "free_offsets.npy", "extra_images.npy"])
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


def test_a_truncated_file_is_found_without_its_digest(folder):
    (folder / "free.npy").write_bytes((folder / "free.npy").read_bytes()[:-8])
    with pytest.raises(DamagedFileError, match=r"free\.npy is no array"):
        open_dataset(folder, verify=False)


def test_a_file_that_would_run_code_is_refused(folder):
    rewrite_pickled = np.array([{"a": 1}], dtype=object)
    np.save(folder / "free.npy", rewrite_pickled, allow_pickle=True)
    with pytest.raises(DamagedFileError, match=r"free\.npy is no array"):
        open_dataset(folder, verify=False)


def test_a_changed_manifest_is_found(folder):
    edit(folder, world=PlanarWorld(TWO_LINK, Camera(pixels=17)).to_dict())
    with pytest.raises(DamagedFileError, match=r"manifest\.json is damaged"):
        open_dataset(folder)


@pytest.mark.parametrize(
    "change",
    [
        {"schema_version": 1},
        {"schema_version": 3},
        {"schema_version": None},
        {"extra_key": 1},
        {"robot": None},
        {"world": None},
        {"world": {}},
        {"world": {"kind": "planar"}},
        {"world": {"kind": "flat", "robot": {}, "camera": {}}},
        {"world": {"kind": "planar", "robot": {"link_lengths_m": [2.0]}, "camera": CAMERA.to_dict()}},
        {"world": {"kind": "planar", "robot": TWO_LINK.to_dict(), "camera": []}},
        {"files": 5},
        {"files": ["images.npy"]},
        {"files": {"images.npy": 5}},
        {"counts": None},
        {"generator": "me"},
    ],
)
def test_a_manifest_that_does_not_follow_the_schema_is_an_error(folder, change):
    edit(folder, **change)
    with pytest.raises(DatasetError, match="manifest"):
        open_dataset(folder)


@pytest.mark.parametrize("text", ["", "[]", "null", "{", "[" * 100_000, "\x00"])
def test_a_manifest_that_is_no_json_object_is_an_error(folder, text):
    (folder / MANIFEST_FILE).write_text(text)
    with pytest.raises(DatasetError, match="manifest"):
        open_dataset(folder)


@pytest.mark.parametrize("member", ['"generator": {"a": 1, "a": 2}', '"generator": {"a": NaN}'])
def test_a_manifest_that_is_no_strict_json_is_an_error(folder, member):
    path = folder / MANIFEST_FILE
    edit(folder, generator="here")
    path.write_text(path.read_text().replace('"generator": "here"', member))
    with pytest.raises(DatasetError, match=r"manifest.*not JSON"):
        open_dataset(folder)


@pytest.mark.parametrize("value", [np.nan, np.float32(1.0), {1}])
def test_a_data_set_whose_making_is_not_plain_json_is_refused_before_it_is_there(tmp_path, value):
    with pytest.raises(DatasetError, match=r"convert .* generator"):
        write_dataset(tmp_path / "data", **content(generator={"rate": value}))
    assert not list(tmp_path.iterdir())


def test_a_seed_of_any_size_survives_the_manifest(tmp_path):
    assert write_dataset(tmp_path / "data", **content(generator={"seed": 2**200})).generator_seed == 2**200


def test_bytes_that_are_no_text_are_an_error(folder):
    (folder / MANIFEST_FILE).write_bytes(b"\xff\xfe\x00")
    with pytest.raises(DatasetError, match="manifest"):
        open_dataset(folder)


def test_a_folder_without_a_manifest_is_no_data_set(tmp_path):
    with pytest.raises(DatasetError, match=r"manifest\.json.*training.datasets import"):
        open_dataset(tmp_path)


def test_a_manifest_cannot_name_files_elsewhere(folder):
    outside = folder.parent / "outside.npy"
    np.save(outside, np.zeros(3))
    manifest = Manifest.read(folder)
    rebuild(folder, manifest, dict(manifest.files) | {"../outside.npy": file_digest(outside)})
    with pytest.raises(DatasetError, match="outside"):
        open_dataset(folder)


# Arrays that do not fit


@pytest.mark.parametrize(
    ("arrays", "words"),
    [
        (
            {"images": np.zeros((3, 16, 16, 4), np.uint8)},
            r"images\.npy.*\(any, 16, 16, 3\).*\(3, 16, 16, 4\)",
        ),
        ({"images": np.zeros((3, 16, 16, 3), np.float32)}, r"images\.npy.*uint8.*float32"),
        ({"images": np.zeros((0, 16, 16, 3), np.uint8)}, r"images\.npy is empty"),
        ({"images": np.zeros((3, 20, 20, 3), np.uint8)}, r"images\.npy"),
        ({"extra_images": np.zeros((2, 16, 15, 3), np.uint8)}, r"extra_images\.npy"),
        ({"free": np.zeros((10, 3), np.float32)}, r"free\.npy.*\(any, 2\).*\(10, 3\)"),
        ({"free": np.zeros((10, 2), np.float64)}, r"free\.npy.*float32.*float64"),
        ({"free": np.full((10, 2), np.nan, np.float32)}, r"free\.npy.*finite.*nan"),
        ({"free": np.full((10, 2), np.inf, np.float32)}, r"free\.npy.*inf"),
        ({"free": np.full((10, 2), 3.2, np.float32)}, r"free\.npy.*\[-pi, pi\).*3\.2"),
        ({"free": np.full((10, 2), np.pi, np.float32)}, r"free\.npy"),
        ({"collision": np.full((3, 2), -3.2, np.float32)}, r"collision\.npy"),
        ({"free_offsets": np.array([0, 4, 4, 9])}, r"free_offsets\.npy.*0 to 10.*0 to 9"),
        ({"free_offsets": np.array([1, 4, 4, 10])}, r"free_offsets\.npy"),
        ({"free_offsets": np.array([0, 6, 4, 10])}, r"free_offsets\.npy"),
        ({"free_offsets": np.array([0, 4, 10])}, r"free_offsets\.npy.*\(4\).*\(3,\)"),
        ({"free_offsets": np.array([0.0, 4.0, 4.0, 10.0])}, r"free_offsets\.npy.*int64"),
        ({"collision_offsets": np.array([0, 1, 3, 4])}, r"collision_offsets\.npy"),
        ({"path_offsets": np.array([0, 5, 8])}, r"path_offsets\.npy"),
        ({"path_scenario": np.array([0, 3])}, r"path_scenario\.npy.*0 to 2.*3"),
        ({"path_scenario": np.array([-1, 2])}, r"path_scenario\.npy.*0 to 2.*-1"),
        ({"discs": np.ones((2, 3, 3))}, r"discs\.npy"),
        ({"discs": np.full((3, 3, 3), np.nan)}, r"discs\.npy.*nan"),
        ({"discs": np.full((3, 3, 3), -1.0)}, r"discs\.npy.*radius|discs\.npy.*radii"),
        ({"notes": np.zeros(3)}, r"notes"),
    ],
)
def test_an_array_that_does_not_fit_is_named_with_what_was_expected(folder, arrays, words):
    rewrite(folder, **arrays)
    with pytest.raises(DatasetError, match=words):
        open_dataset(folder)


@pytest.mark.parametrize("name", ["images", "free", "free_offsets", "collision_offsets", "path_scenario"])
def test_an_array_that_is_left_out_is_named(folder, name):
    manifest = Manifest.read(folder)
    rebuild(folder, manifest, {file: sha for file, sha in manifest.files.items() if file != f"{name}.npy"})
    with pytest.raises(DatasetError, match=name):
        open_dataset(folder)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"free": [np.zeros((2, 3))] * 3}, r"free.*\(n, 2\).*\(2, 3\)"),
        ({"free": [np.full((2, 2), np.nan)] * 3}, "free.*finite"),
        ({"free": [np.zeros((2, 2))] * 2}, "free_offsets"),
        ({"collision": [np.zeros(2)] * 3}, "collision"),
        ({"paths": [(3, np.zeros((2, 2)))]}, "path_scenario"),
        ({"images": np.zeros((3, 15, 15, 3), np.uint8)}, "images"),
        ({"extra_images": np.zeros((1, 16, 16), np.uint8)}, "extra_images"),
        ({"scenes": {"discs": np.ones((4, 3, 3))}}, "discs"),
    ],
)
def test_a_data_set_that_does_not_fit_is_not_written(tmp_path, change, words):
    with pytest.raises(DatasetError, match=words):
        write_dataset(tmp_path / "data", **content(**change))
    assert list(tmp_path.iterdir()) == []


def test_a_data_set_of_before_limits_were_kept_is_read(tmp_path):
    folder = write_dataset(tmp_path / "data", **content()).folder
    limited = PlanarArm(joint_limits_rad=((-0.1, 0.1), (-4.0, 4.0)))
    manifest = replace(Manifest.read(folder), world=PlanarWorld(limited, CAMERA))
    rebuild(folder, manifest, manifest.files)
    assert open_dataset(folder).world.body == limited
    free = open_dataset(folder).arrays["free"]
    assert (np.abs(free[:, 0]) > 0.1).any()
