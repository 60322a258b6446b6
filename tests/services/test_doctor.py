"""``python -m services.doctor``: verdicts, exit codes and the picture."""

import json
from dataclasses import replace

import numpy as np
import pytest

from cspace.worlds.spatial.poses import pose_of
from cspace.worlds.spatial.view import write_view
from services.doctor import main
from tests.cspace.worlds.spatial.test_diagnosis import CAMERA, VIEW


def file_of(folder, view):
    path = folder / "view.bin"
    path.write_bytes(write_view(view))
    return str(path)


def shifted():
    pose = CAMERA.matrix
    pose[:3, 3] += (0.03, 0.0, 0.0)
    return replace(VIEW, cameras=(replace(CAMERA, pose=pose_of(pose)),))


def test_a_right_view_ends_with_0_and_notes(tmp_path, capsys):
    assert main([file_of(tmp_path, VIEW)]) == 0
    output = capsys.readouterr().out
    assert output.startswith("nothing wrong was found\nnote: picture 0")


def test_a_mistake_ends_with_3_a_remedy_a_pose_and_a_picture(tmp_path, capsys):
    wrong = file_of(tmp_path, shifted())
    assert main([wrong]) == 3
    output = capsys.readouterr().out
    assert output.startswith("extrinsics (picture 0): the camera stands elsewhere")
    assert "do: calibrate again or take the suggested pose" in output
    assert main([wrong, "--json", "--picture", str(tmp_path / "seen.png")]) == 3
    found = json.loads(capsys.readouterr().out)
    assert [one["code"] for one in found["findings"]] == ["extrinsics"]
    assert np.linalg.norm(np.array(found["poses"][0]["pose"])[:3, 3] - CAMERA.matrix[:3, 3]) < 0.01
    assert (tmp_path / "seen.png").read_bytes().startswith(b"\x89PNG")


@pytest.mark.parametrize(
    "options",
    [["--picture", "nowhere/seen.png"], ["--picture", "seen.mid"], ["--robot", "r2d2"], ["--bundle", "none"]],
)
def test_wrong_usage_ends_with_2_or_1_and_says_why(options, tmp_path, capsys):
    assert main([file_of(tmp_path, VIEW), *options]) in (1, 2)
    assert capsys.readouterr().err.startswith("error: ")


def test_a_file_that_is_no_view_ends_with_2(tmp_path, capsys):
    path = tmp_path / "view.bin"
    path.write_bytes(b"cspace-view 1 {}\n")
    assert main([str(path)]) == 2
    assert main([str(tmp_path / "none")]) == 2
    assert "error: " in capsys.readouterr().err


def test_another_robot_is_found_not_to_be_the_one_in_the_picture(tmp_path, capsys):
    six = replace(VIEW, state=VIEW.state[:6])
    assert main([file_of(tmp_path, six), "--robot", "ur5"]) == 3
    assert "arm" in capsys.readouterr().out
