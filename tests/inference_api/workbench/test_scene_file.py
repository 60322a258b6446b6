"""Scene files that are opened in the workbench, held against the reader of the command lines."""

import json
from pathlib import Path
from typing import Any

import pytest

from services.scene_files import read_scene_file
from tests.inference_api.client import ApiClient

TEXT = """\
name: bench-arm
robot:
  link_lengths_m: [2.0, 2.0]
  joint_limits_rad: [null, [-2.5, 2.5]]
obstacles:
  - {x_m: 1.5, y_m: 2, radius_m: 0.4}
  - {x_m: -1.5, y_m: 2}
start: [0, 0.4]
goal: [-1.8, -0.5]
"""


def scene_file(bench: ApiClient, text: str) -> dict[str, Any]:
    answer = bench.post("/workbench/scene-file", json={"text": text})
    assert answer.status_code == 200, answer.text
    found: dict[str, Any] = answer.json()
    return found


def test_a_file_is_told_as_the_reader_has_it_with_what_it_leaves_out(
    bench: ApiClient, tmp_path: Path
) -> None:
    path = tmp_path / "scene.yaml"
    path.write_text(TEXT)
    scene = read_scene_file(path)
    found = scene_file(bench, TEXT)
    assert found["robot"] == json.loads(json.dumps(scene.world.to_dict()["robot"]))
    assert found["obstacles"] == [
        {"x_m": 1.5, "y_m": 2.0, "radius_m": 0.4},
        {"x_m": -1.5, "y_m": 2.0, "radius_m": 1.0},
    ]
    assert (found["start"], found["goal"]) == ([0.0, 0.4], [-1.8, -0.5])
    # What is told is a scene file again.
    assert scene_file(bench, json.dumps(found)) == found


def test_ends_that_a_file_leaves_out_are_left_out(bench: ApiClient) -> None:
    assert scene_file(bench, TEXT.partition("start")[0]).keys() == {"robot", "obstacles"}


WRONG = {
    "a wrong value": (TEXT.replace("0.4}", "-1}"), "the file:6: the file: obstacles.0.radius_m"),
    "an unknown key": (TEXT + "colour: red\n", "the file:10"),
    "no YAML": ("robot: [", "the file:1 is no YAML"),
    "no obstacles": ("robot: {link_lengths_m: [1, 1]}", "holds no scene"),
    "aliases": (
        "\n".join(["a: &a0 [1]", *(f"{n}: &a{n} [{','.join([f'*a{n - 1}'] * 10)}]" for n in range(1, 9))]),
        "the file:6: it holds too many values",
    ),
    "tags": ("robot: !!python/object:os.system {}", "the file:1: a value does not fit"),
    "half a letter": ("\ud800", "the file"),
    "too many discs": (
        json.dumps({"robot": {"link_lengths_m": [1, 1]}, "obstacles": [{"x_m": 3, "y_m": 3}] * 65}),
        "obstacles does not fit; expected Tuple should have at most 64 items",
    ),
    "another world": ("world: spatial\nrobot: ../pretrained\n", "the file:1: the world is unknown"),
}


@pytest.mark.parametrize("name", WRONG)
def test_what_is_no_scene_is_told_with_its_line(bench: ApiClient, name: str) -> None:
    text, words = WRONG[name]
    body, json_type = json.dumps({"text": text}), {"content-type": "application/json"}
    answer = bench.post("/workbench/scene-file", content=body, headers=json_type)
    assert 400 <= answer.status_code < 500
    assert name == "half a letter" or words in answer.json()["detail"], answer.text


def test_a_text_that_is_too_long_is_refused_before_it_is_read(bench: ApiClient) -> None:
    answer = bench.post("/workbench/scene-file", json={"text": "#" * (2**15 + 1)})
    assert answer.status_code == 422
    assert answer.json()["errors"][0]["field"] == "text"
