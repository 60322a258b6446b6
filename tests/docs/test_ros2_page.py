"""The ROS 2 node of the integrations page: depth pictures, and what goes wrong."""

import io
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

from cspace.simulator import Split
from cspace.worlds import examples, picture_file_of, simulator_of
from cspace.worlds.spatial.view import read_view
from inference_api.settings import PRETRAINED_FOLDER
from tests.docs.blocks import ROOT, Kind, blocks
from tests.inference_api.server import api_server

PAGE = ROOT / "docs" / "integrations.md"
JOINTS = [f"panda_joint{number}" for number in range(1, 8)]


@pytest.fixture(scope="module")
def page() -> dict[str, Any]:
    """The names that the page's blocks make, up to the node."""
    names: dict[str, Any] = {}
    for block in blocks(PAGE):
        if block.kind is Kind.PYTHON and "http://" not in block.source:
            exec(block.source, names)  # noqa: S102 - the documents are the project's own
    assert {"Planner", "png_of"} <= names.keys()
    return names


def image_of(page: dict[str, Any], pixels: np.ndarray[Any, Any], encoding: str, padding: int = 0) -> Any:
    """A message whose rows are longer than its pixels."""
    rows = pixels.reshape(len(pixels), -1).view(np.uint8)
    padded = np.pad(rows, ((0, 0), (0, padding)), constant_values=255)
    height, width = pixels.shape[:2]
    shape = {"height": height, "width": width, "step": padded.shape[1]}
    return page["Image"](encoding=encoding, data=padded.tobytes(), **shape)


def decoded(png: bytes) -> np.ndarray[Any, Any]:
    with Image.open(io.BytesIO(png)) as picture:
        return np.asarray(picture)


@pytest.mark.parametrize("padding", [0, 4])
def test_depth_in_metres_and_in_millimetres_is_the_same_picture(page: dict[str, Any], padding: int) -> None:
    metres = np.array([[0.5, np.nan, 1.25], [np.inf, 0.0, 70.0]], dtype=np.float32)
    expected = [[500, 0, 1250], [0, 0, 65535]]
    assert decoded(page["png_of"](image_of(page, metres, "32FC1", padding))).tolist() == expected
    millimetres = np.array(expected, dtype=np.uint16)
    assert decoded(page["png_of"](image_of(page, millimetres, "16UC1", padding))).tolist() == expected


def test_colours_are_kept_whatever_their_order(page: dict[str, Any]) -> None:
    pixels = np.arange(2 * 3 * 3, dtype=np.uint8).reshape(2, 3, 3)
    assert np.array_equal(decoded(page["png_of"](image_of(page, pixels, "rgb8"))), pixels)
    assert np.array_equal(decoded(page["png_of"](image_of(page, pixels[:, :, ::-1].copy(), "bgr8"))), pixels)
    with pytest.raises(ValueError, match="got mono8"):
        page["png_of"](image_of(page, pixels, "mono8"))


def test_a_turn_across_the_seam_goes_the_shorter_way_and_takes_its_time(page: dict[str, Any]) -> None:
    node = page["Planner"]("http://127.0.0.1:9", ["joint"], speed_rad_s=0.5)
    path = node.trajectory(np.array([[3.0], [-3.0], [-2.0]]))
    angles = [point.positions[0] for point in path.points]
    assert np.allclose(angles, [3.0, 2 * np.pi - 3.0, 2 * np.pi - 2.0])
    times = [point.time_from_start.sec + point.time_from_start.nanosec * 1e-9 for point in path.points]
    assert np.allclose(times, [0.0, 2 * (2 * np.pi - 6.0), 2 * (2 * np.pi - 6.0) + 2.0])


def test_a_goal_before_the_first_picture_or_without_a_server_is_told(page: dict[str, Any]) -> None:
    node = page["Planner"]("http://127.0.0.1:9", ["a", "b"])
    goal = page["JointState"](name=["a", "b"], position=[0.0, 0.0])
    node.on_goal(goal)
    node.on_image(image_of(page, np.zeros((48, 48, 3), np.uint8), "rgb8"))
    node.on_state(goal)
    node.on_goal(goal)
    assert node.published == []
    assert "no picture" in node.warnings[0]
    assert "does not answer" in node.warnings[1]


@pytest.fixture
def space_api(tmp_path: Path) -> Iterator[str]:
    arm = PRETRAINED_FOLDER.with_name("pretrained_panda")
    with api_server(tmp_path, {"CSPACE_PRETRAINED_MODEL": str(arm)}) as found:
        yield found


@pytest.mark.slow
@pytest.mark.e2e
@pytest.mark.timeout(600)
def test_a_depth_picture_and_a_goal_become_a_trajectory_of_seven_joints(
    page: dict[str, Any], space_api: str
) -> None:
    world = examples()["panda"]
    problem = simulator_of(world).problem("shelf", Split.DEMO, 12)
    taken = read_view(picture_file_of(problem.scenario), world.body)
    values = taken.cameras[0].to_dict()
    k = [values["fx"], 0.0, values["cx"], 0.0, values["fy"], values["cy"], 0.0, 0.0, 1.0]
    node = page["Planner"](space_api, JOINTS, values["pose"], model="pretrained", least=0.0)
    node.client.timeout = 300.0
    node.on_camera(page["CameraInfo"](width=values["width"], height=values["height"], k=k))
    node.on_image(image_of(page, taken.pictures[0], "16UC1"))
    node.on_state(page["JointState"](name=JOINTS[::-1], position=problem.start[::-1].tolist()))
    node.on_goal(page["JointState"](name=JOINTS, position=problem.goal.tolist()))
    node.client.close()
    assert node.warnings == []
    points = [point.positions for point in node.published[0].points]
    assert np.allclose(points[0], problem.start, atol=1e-3)
    assert np.allclose(points[-1], problem.goal, atol=1e-3)
    assert {len(point) for point in points} == {7}
