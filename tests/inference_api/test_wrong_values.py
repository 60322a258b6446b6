"""Wrong values and pictures: 422, named, and the server answers the next request."""

import base64
import json
import struct
import zlib
from typing import Any

import numpy as np
import pytest

from cspace.png import encode_png
from cspace.worlds.spatial.camera import encode_depth
from tests.inference_api.answers import IMAGE, PNG, assert_answers, assert_problem
from tests.inference_api.client import ApiClient

PATH = {"model": "cspace-sampler@path"}
ENDS = PATH | {"start": [0, 0], "goal": [0, 0]}
WRONG: dict[str, list[object]] = {
    "n": [0, -1, 20_001, 2.5, True, "30", None, 10**300],
    "model": [3, "", "../secret", "a/b/c", "a@b@c", "cspace-sampler/0", "cspace-sampler/-1", "x" * 200],
    "seed": [-1, 2**64, str(2**64), "-1", "0x1", "²", 1.5, True],
    "epsilon_sigma": [[], -0.1, [0, 10.5], ["0"], [True], [0] * 1001, 1e999],
    # The model has no validity head.
    "min_confidence": [-0.1, 1.1, "0.5", 0.5],
    "start": ["[0, 0]", [[0, 0]], [0, 0]],
    "goal": [[0, 0]],
    "image": ["not base64!", IMAGE[:-1], None, [1, 2]],
    "robot": ["", "two link", "-two", "A" * 64, "a" * 65, f"{'a' * 64}\n"],
    "seeds": [3],
    "": [3],
}
OF_PATHS = [
    ("start", PATH | {"goal": [0, 0]}),
    ("goal", PATH | {"start": [0, 0]}),
    ("start", ENDS | {"start": [0]}),
    ("goal", ENDS | {"goal": [0, 0, 0]}),
    ("goal", ENDS | {"goal": [0, None]}),
]


@pytest.mark.parametrize("field", WRONG)
def test_a_wrong_value_in_json_is_422_and_named(api: ApiClient, field: str) -> None:
    assert_named(api, [(field, {field: value}) for value in WRONG[field]])


def test_ends_that_a_path_model_cannot_take_are_named(api: ApiClient) -> None:
    assert_named(api, OF_PATHS)


def assert_named(api: ApiClient, cases: list[tuple[str, dict[str, Any]]]) -> None:
    for field, change in cases:
        body = json.dumps({"image": IMAGE, "n": 3, **change}).replace("Infinity", "1e999")
        answer = api.post("/sample", content=body.encode(), headers={"content-type": "application/json"})
        problem = assert_problem(answer, 422, "invalid-value")
        assert field in problem["detail"]
        assert {"expected", "got"} <= set(problem)
    assert_answers(api)


WRONG_PARTS: list[tuple[str, list[tuple[str, Any]]]] = [
    ("image", [("n", (None, "3"))]),
    ("image", [("image", (None, IMAGE))]),
    ("image", [("image", ("a.png", PNG)), ("image", ("b.png", PNG))]),
    ("n", [("image", PNG), ("n", (None, "many"))]),
    ("n", [("image", PNG), ("n", (None, "1_0"))]),
    ("n", [("image", PNG), ("n", (None, "2.0"))]),
    ("n", [("image", PNG), ("n", (None, ""))]),
    ("n", [("image", PNG), ("n", (None, "3")), ("n", (None, "3"))]),
    ("n", [("image", PNG), ("n", ("n.txt", b"3"))]),
    # Words of an exhausted machine, which only its own errors may be taken for.
    ("n", [("image", PNG), ("n", (None, "can't start new thread, bad_alloc"))]),
    ("seed", [("image", PNG), ("seed", (None, "seven"))]),
    ("epsilon_sigma", [("image", PNG), ("epsilon_sigma", (None, "nan"))]),
    ("epsilon_sigma", [("image", PNG), ("epsilon_sigma", (None, "1e99"))]),
    ("epsilon_sigma", [("image", PNG), ("epsilon_sigma", (None, "0")), ("epsilon_sigma", (None, "11"))]),
    ("min_confidence", [("image", PNG), ("min_confidence", (None, "2"))]),
    ("start", [("image", PNG), ("start", (None, "3"))]),
    ("colour", [("image", PNG), ("colour", (None, "red"))]),
    ("picture", [("image", PNG), ("picture", ("a.png", PNG))]),
]


def test_a_wrong_value_in_a_form_is_422_and_named(api: ApiClient) -> None:
    for field, parts in WRONG_PARTS:
        problem = assert_problem(api.post("/sample", files=parts), 422, "invalid-value")
        assert field in problem["detail"], parts
    assert_answers(api)


def test_several_wrong_fields_are_all_reported(api: ApiClient) -> None:
    answer = api.post("/sample", json={"n": 0, "seed": -1, "colour": 1})
    problem = assert_problem(answer, 422, "invalid-value")
    assert {item["field"] for item in problem["errors"]} == {"image", "n", "seed", "colour"}


def claimed_size(width: int, height: int) -> bytes:
    """A PNG whose header claims a size that its data does not have."""
    header = struct.pack(">IIBBBBB", width, height, 8, 2, 0, 0, 0)
    chunk = b"IHDR" + header
    return PNG[:8] + struct.pack(">I", 13) + chunk + struct.pack(">I", zlib.crc32(chunk)) + PNG[33:]


IMAGES = {
    "empty": b"",
    "text": b"hello",
    "cut": PNG[: len(PNG) // 2],
    "16 bit": encode_depth(np.zeros((48, 48), np.uint16)),
    "not square": encode_png(np.zeros((48, 49, 3), np.uint8)),
    "bomb": claimed_size(50_000, 50_000),
    "false size": claimed_size(2048, 2048),
}


@pytest.mark.parametrize("name", IMAGES)
def test_a_picture_that_is_not_acceptable_is_422(api: ApiClient, name: str) -> None:
    data = IMAGES[name]
    for answer in (
        api.post("/sample", json={"image": base64.b64encode(data).decode()}),
        api.post("/sample", files={"image": ("scenario.png", data, "image/png")}),
    ):
        assert_problem(answer, 422, "invalid-image")
    assert_answers(api)
