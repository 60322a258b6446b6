"""Recordings of depth cameras: pictures with their cameras, beside configurations that were tried."""

import json
import re

import numpy as np
import pytest

from cspace.dataset import open_dataset
from cspace.errors import DatasetError
from cspace.view_file import pack_view
from tests.inference_api.test_depth_pictures import CAMERAS, FLOATS, IMAGES, OTHER_CAMERAS, STATE
from tests.space_bundle import WORLD
from training.data.__main__ import main
from training.data.own_data import import_folder

ROWS = WORLD.space.sample_uniform(np.random.default_rng(3), 12)


def record(folder, state=tuple(STATE), **changed):
    """Two scenes: one of two pictures, one of a single picture without the arm."""
    folder.mkdir(parents=True)
    for name, picture in (("left.png", IMAGES[0]), ("right.png", IMAGES[1]), ("desk.png", IMAGES[1])):
        (folder / name).write_bytes(picture)
    values = {"pictures": ["left.png", "right.png"], "cameras": CAMERAS, "state": list(state), **changed}
    (folder / "shelf.json").write_text(json.dumps(values))
    (folder / "desk.json").write_text(json.dumps({"pictures": ["desk.png"], "cameras": CAMERAS[1:]}))
    np.save(folder / "shelf.npy", ROWS[:5])
    np.save(folder / "shelf.collision.npy", ROWS[5:9])
    np.save(folder / "desk.npy", ROWS[9:])
    return folder


def test_recordings_become_a_data_set_of_the_arm(tmp_path, capsys):
    source = record(tmp_path / "own")
    assert main(["import", str(source), str(tmp_path / "data"), "--arm", "panda"]) == 0
    assert "digest" in capsys.readouterr().out
    dataset = open_dataset(tmp_path / "data", verify=True)
    assert (dataset.world.body, dataset.world.scenes, dataset.scenario_count) == (WORLD.body, None, 2)
    desk, shelf = pack_view(IMAGES[1:], CAMERAS[1:], None), pack_view(IMAGES, CAMERAS, STATE)
    np.testing.assert_array_equal(dataset.images[0], WORLD.read_picture(desk))
    np.testing.assert_array_equal(dataset.images[1], WORLD.read_picture(shelf))
    np.testing.assert_allclose(dataset.free_of(1), ROWS[:5], atol=1e-6)
    assert [len(dataset.collision_of(place)) for place in range(2)] == [0, 4]


def test_pictures_of_another_unit_are_read_in_it(tmp_path):
    source = record(tmp_path / "own", depth_scale_m=0.0005)
    dataset = import_folder(source, tmp_path / "data", world=WORLD)
    shelf = WORLD.read_picture(pack_view(IMAGES, CAMERAS, STATE, 0.0005))
    np.testing.assert_array_equal(dataset.images[1], shelf)
    assert not np.array_equal(shelf, WORLD.read_picture(pack_view(IMAGES, CAMERAS, STATE)))


def test_floats_messages_of_ros_and_view_files_are_the_same_data_set(tmp_path):
    expected = import_folder(record(tmp_path / "own"), tmp_path / "data", world=WORLD)
    floats = record(tmp_path / "floats", pictures=["left.npy", "right.npy"], cameras=OTHER_CAMERAS)
    for name, data in zip(("left.npy", "right.npy"), FLOATS, strict=True):
        (floats / name).write_bytes(data)
        (floats / name).with_suffix(".png").unlink()
    view = record(tmp_path / "view")
    for name in ("shelf.json", "left.png", "right.png"):
        (view / name).unlink()
    (view / "shelf.view").write_bytes(pack_view(IMAGES, CAMERAS, STATE))
    for source in (floats, view):
        found = import_folder(source, tmp_path / f"data of {source.name}", world=WORLD)
        np.testing.assert_array_equal(found.images, expected.images)


def test_views_without_configurations_lie_in_extra(tmp_path):
    source = record(tmp_path / "own")
    record(source / "extra")
    for path in (source / "extra").glob("*.npy"):
        path.unlink()
    dataset = import_folder(source, tmp_path / "data", world=WORLD)
    assert len(dataset.extra_images) == 2


NO_VIEW = [
    ({"cameras": CAMERAS[:1]}, "the depth pictures do not fit.*2 pictures, 1 cameras"),
    ({"pictures": []}, "pictures does not fit.*at least 1"),
    ({"pictures": ["../left.png"]}, r"pictures\.0 does not fit.*a file beside it"),
    ({"pictures": ["left.png", "right.png", "gone.png"]}, "gone.png cannot be read"),
    ({"cameras": [{"fx": 1.0}, {}]}, "the camera"),
    ({"state": [0.0]}, "the state does not fit the robot"),
]


@pytest.mark.parametrize(("changed", "message"), NO_VIEW, ids=[message for _, message in NO_VIEW])
def test_what_does_not_fit_is_named_and_nothing_is_written(tmp_path, changed, message):
    source = record(tmp_path / "own", **changed)
    with pytest.raises(DatasetError, match=r"(?s)shelf\.json|gone\.png") as raised:
        import_folder(source, tmp_path / "data", world=WORLD)
    assert re.search(message, str(raised.value))
    assert not (tmp_path / "data").exists()


def test_a_file_that_is_no_json_and_a_picture_without_a_camera_are_told(tmp_path):
    source = record(tmp_path / "own")
    (source / "shelf.json").write_text("{")
    with pytest.raises(DatasetError, match=r"shelf\.json is no JSON"):
        import_folder(source, tmp_path / "data", world=WORLD)
    for name in ("shelf.json", "shelf.npy", "shelf.collision.npy"):
        (source / name).unlink()
    with pytest.raises(DatasetError, match=r"left\.npy is missing"):
        import_folder(source, tmp_path / "data", world=WORLD)
