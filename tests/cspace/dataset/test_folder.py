import numpy as np
import pytest

from cspace.dataset import open_dataset, write_dataset
from cspace.errors import DatasetError
from cspace.worlds.planar.arm import THREE_LINK, TWO_LINK, PlanarArm
from cspace.worlds.planar.world import PlanarWorld
from tests.dataset_content import CAMERA, SCENARIOS, content


@pytest.fixture
def folder(tmp_path):
    return write_dataset(tmp_path / "data", **content()).folder


@pytest.mark.parametrize("robot", [TWO_LINK, THREE_LINK, PlanarArm(joint_limits_rad=(None, (-1.0, 3.0)))])
def test_what_was_written_is_read_back(tmp_path, robot):
    values = content(robot)
    write_dataset(tmp_path / "deep" / "data", **values)
    dataset = open_dataset(tmp_path / "deep" / "data")
    assert dataset.world == PlanarWorld(robot, CAMERA)
    assert (dataset.scenario_count, dataset.generator_seed) == (SCENARIOS, 7)
    np.testing.assert_array_equal(dataset.images, values["images"])
    np.testing.assert_array_equal(dataset.extra_images, values["extra_images"])
    np.testing.assert_array_equal(dataset.arrays["discs"], values["scenes"]["discs"])
    for index in range(SCENARIOS):
        np.testing.assert_allclose(dataset.free_of(index), values["free"][index], atol=1e-6)
        np.testing.assert_allclose(dataset.collision_of(index), values["collision"][index], atol=1e-6)
    counts = dataset.manifest.counts
    assert (counts["images"], counts["free"], counts["collision"]) == (3, 10, 3)
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


PICTURES = np.zeros((3, 16, 16, 3), np.uint8)
WRONG = {
    "images": ({"images": PICTURES[:, 1:]}, r"images.*16, 16, 3.*3, 15, 16, 3"),
    "their type": ({"images": PICTURES.astype(np.float32)}, r"images.*uint8.*float32"),
    "none": (content(images=PICTURES[:0], free=[], collision=None, paths=None, scenes=None), "n above 0"),
    "extra_images": ({"extra_images": PICTURES[:, :, 1:]}, "extra_images"),
    "free": ({"free": [np.zeros((2, 3))] * 3}, r"free.*\(n, 2\).*\(2, 3\)"),
    "not finite": ({"free": [np.full((2, 2), np.nan)] * 3}, "free.*outside.*nan"),
    "scenarios": ({"free": [np.zeros((2, 2))] * 2}, "free_offsets"),
    "paths": ({"paths": [(3, np.zeros((2, 2)))]}, "path_scenario"),
    "discs": ({"scenes": {"discs": np.ones((4, 3, 3))}}, "discs"),
    "radii": ({"scenes": {"discs": np.full((3, 3, 3), -1.0)}}, "discs.*radius"),
}


@pytest.mark.parametrize(("change", "words"), WRONG.values(), ids=WRONG)
def test_a_data_set_that_does_not_fit_is_not_written(tmp_path, change, words):
    with pytest.raises(DatasetError, match=words):
        write_dataset(tmp_path / "data", **content(**change))
    assert list(tmp_path.iterdir()) == []
