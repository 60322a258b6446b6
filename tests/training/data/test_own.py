import numpy as np
import pytest
from PIL import Image

from cspace.dataset import open_dataset
from cspace.errors import DatasetError, StorageError
from cspace.simulator import Split
from cspace.worlds.planar.arm import THREE_LINK, TWO_LINK, PlanarArm
from cspace.worlds.planar.camera import Camera
from cspace.worlds.planar.simulator import render
from cspace.worlds.planar.world import PlanarWorld
from tests.scenarios import random_scenarios
from training.data.own_data import import_folder


def fill(folder, robot=TWO_LINK, *, collision=True, extra=True):
    """Three scenarios as somebody would bring them; returns the angles of each by name."""
    folder.mkdir()
    rng, angles = np.random.default_rng(0), {}
    for name, scenario in zip(("b", "a", "c"), random_scenarios(Split.DEMO, 0, 3), strict=True):
        Image.fromarray(render(scenario)).save(folder / f"{name}.png")
        angles[name] = rng.uniform(-np.pi, np.pi, (int(rng.integers(1, 9)), robot.dim))
        np.save(folder / f"{name}.npy", angles[name])
    if collision:
        np.save(folder / "a.collision.npy", np.ones((4, robot.dim), dtype=np.float32))
    if extra:
        (folder / "extra").mkdir()
        Image.new("L", (200, 200), 99).save(folder / "extra" / "wall.png")
    return angles


def take(source, folder, robot=TWO_LINK, camera=None):
    return import_folder(source, folder, world=PlanarWorld(robot, camera or Camera()))


@pytest.mark.parametrize("robot", [TWO_LINK, THREE_LINK])
def test_own_pictures_become_a_data_set_in_the_order_of_their_names(tmp_path, robot):
    angles = fill(tmp_path / "own", robot)
    take(tmp_path / "own", tmp_path / "data", robot)
    dataset = open_dataset(tmp_path / "data")
    assert (dataset.world.body, dataset.scenario_count) == (robot, 3)
    for index, name in enumerate("abc"):
        np.testing.assert_allclose(dataset.free_of(index), angles[name], atol=1e-6)
        picture = np.asarray(Image.open(tmp_path / "own" / f"{name}.png"))
        np.testing.assert_array_equal(dataset.images[index], picture)
    assert [len(dataset.collision_of(index)) for index in range(3)] == [4, 0, 0]
    assert (dataset.extra_images == 99).all()
    assert dataset.manifest.generator == {"imported": ["a.png", "b.png", "c.png"]}
    assert dataset.generator_seed is None


def test_pictures_are_resized_to_the_cameras_pixels_and_collisions_and_extra_ones_are_optional(tmp_path):
    fill(tmp_path / "own", collision=False, extra=False)
    camera = Camera(-4.0, 4.0, -4.0, 4.0, 24)
    dataset = take(tmp_path / "own", tmp_path / "data", camera=camera)
    assert dataset.world.sensor == camera
    assert dataset.images.shape == (3, 24, 24, 3)
    assert dataset.collision is None
    assert dataset.extra_images is None


def test_whole_numbers_and_full_turns_are_angles_too(tmp_path):
    fill(tmp_path / "own")
    np.save(tmp_path / "own" / "a.npy", np.array([[7, -7]]))
    dataset = take(tmp_path / "own", tmp_path / "data")
    np.testing.assert_allclose(dataset.free_of(0), [[7 - 2 * np.pi, 2 * np.pi - 7]], atol=1e-6)


def array(name, value):
    return lambda folder: np.save(folder / name, value, allow_pickle=True)


def content(name, data):
    return lambda folder: (folder / name).write_bytes(data)


def header(text):
    """An array's file that is a header alone."""
    padded = text.encode().ljust(117) + b"\n"
    return content("b.npy", b"\x93NUMPY\x01\x00" + len(padded).to_bytes(2, "little") + padded)


def huge(rows):
    return header(f"{{'descr': '<f8', 'fortran_order': False, 'shape': ({rows}, 2), }}")


def packed(folder):
    with (folder / "b.npy").open("wb") as file:
        np.savez(file, b=np.zeros((3, 2)))


def no_pictures(folder):
    for path in folder.glob("*.png"):
        path.unlink()


@pytest.mark.parametrize(
    ("spoil", "words"),
    [
        (array("b.npy", np.zeros((3, 3))), r"b\.npy does not fit.*\(n, 2\).*\(3, 3\)"),
        (array("b.npy", np.zeros((3, 2), dtype=complex)), r"b\.npy does not fit.*complex"),
        (array("b.npy", np.full((3, 2), np.nan)), r"b\.npy.*finite"),
        (array("a.collision.npy", np.full((3, 2), np.inf)), r"a\.collision\.npy.*finite"),
        (array("b.npy", np.array([[{}, {}]], dtype=object)), r"b\.npy is no array"),
        (content("b.npy", b"1.0 2.0"), r"b\.npy is no array"),
        (packed, r"b\.npy is no array"),
        (huge(2**40), r"b\.npy is no array"),
        (huge(2**70), r"b\.npy is no array"),
        (header("{1: 2, 'a': 3, None: 1}"), r"b\.npy is no array"),
        (header("-" * 9000 + "1"), r"b\.npy is no array"),
        (lambda folder: (folder / "b.npy").unlink(), r"b\.npy is missing.*extra/"),
        (array("d.collision.npy", np.zeros((1, 2))), r"d\.collision\.npy belongs to no picture"),
        (lambda folder: Image.new("RGB", (48, 50)).save(folder / "b.png"), r"b\.png: .* a square of"),
        (content("b.png", b"GIF89a" * 20), r"b\.png: the picture is not a PNG"),
        (content("b.png", bytes(8 * 2**20 + 1)), r"b\.png is too large"),
        (no_pictures, "holds no pictures"),
    ],
)
def test_a_file_that_does_not_fit_is_named_and_nothing_is_written(tmp_path, spoil, words):
    fill(tmp_path / "own")
    spoil(tmp_path / "own")
    with pytest.raises(DatasetError, match=words):
        take(tmp_path / "own", tmp_path / "data")
    assert [path.name for path in tmp_path.iterdir()] == ["own"]


def test_a_source_that_is_not_there_and_an_existing_data_set_are_told(tmp_path):
    with pytest.raises(DatasetError, match="holds no pictures"):
        take(tmp_path / "own", tmp_path / "data")
    fill(tmp_path / "own")
    take(tmp_path / "own", tmp_path / "data")
    with pytest.raises(StorageError, match="exists"):
        take(tmp_path / "own", tmp_path / "data")


def test_configurations_outside_the_limits_or_in_degrees_are_refused_and_not_wrapped(tmp_path):
    fill(tmp_path / "own", collision=False)
    robot = PlanarArm(joint_limits_rad=(None, (-4.0, 3.2)))
    take(tmp_path / "own", tmp_path / "data", robot)
    np.save(tmp_path / "own" / "a.npy", [[0.0, -3.9], [0.0, 3.3]])
    with pytest.raises(DatasetError, match=r"a\.npy holds configurations outside") as refused:
        take(tmp_path / "own", tmp_path / "other", robot)
    assert "3.3" in refused.value.got
    np.save(tmp_path / "own" / "a.npy", [[0.5, 1.0], [47.08, -79.14]])
    with pytest.raises(DatasetError, match=r"a\.npy holds configurations outside.*not in degrees") as refused:
        take(tmp_path / "own", tmp_path / "other")
    assert "row 1: joint 1 at 47.08 rad" in refused.value.got
    assert not (tmp_path / "other").exists()
    np.save(tmp_path / "own" / "a.npy", [[9.0, -3.9]])
    kept = take(tmp_path / "own", tmp_path / "other", robot).free_of(0)
    np.testing.assert_allclose(kept, [[9.0 - 2.0 * np.pi, -3.9]], rtol=1e-6)
