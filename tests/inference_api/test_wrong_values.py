"""Wrong values and pictures: 422, named, and the server answers the next request."""

import base64
import io
import json
import struct
import zlib
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from PIL import Image

from tests.inference_api.answers import IMAGE, PNG, assert_answers, assert_problem
from tests.inference_api.client import ApiClient


def saved(image: Image.Image, kind: str = "PNG", **options: Any) -> bytes:
    buffer = io.BytesIO()
    image.save(buffer, kind, **options)
    return buffer.getvalue()


def claimed_size(width: int, height: int) -> bytes:
    """A PNG whose header claims a size that its data does not have."""
    header = struct.pack(">IIBBBBB", width, height, 8, 2, 0, 0, 0)
    chunk = b"IHDR" + header
    return PNG[:8] + struct.pack(">I", 13) + chunk + struct.pack(">I", zlib.crc32(chunk)) + PNG[33:]


WRONG_FIELDS: list[tuple[str, dict[str, Any]]] = [
    ("n", {"n": 0}),
    ("n", {"n": -1}),
    ("n", {"n": 20_001}),
    ("n", {"n": 2.5}),
    ("n", {"n": True}),
    ("n", {"n": "30"}),
    ("n", {"n": None}),
    ("n", {"n": 10**300}),
    ("model", {"model": 3}),
    ("model", {"model": ""}),
    ("model", {"model": "../secret"}),
    ("model", {"model": "a/b/c"}),
    ("model", {"model": "a@b@c"}),
    ("model", {"model": "cspace-sampler/0"}),
    ("model", {"model": "cspace-sampler/-1"}),
    ("model", {"model": "x" * 200}),
    ("seed", {"seed": -1}),
    ("seed", {"seed": 2**64}),
    ("seed", {"seed": str(2**64)}),
    ("seed", {"seed": "-1"}),
    ("seed", {"seed": "0x1"}),
    ("seed", {"seed": "²"}),
    ("seed", {"seed": 1.5}),
    ("seed", {"seed": True}),
    ("epsilon_sigma", {"epsilon_sigma": []}),
    ("epsilon_sigma", {"epsilon_sigma": -0.1}),
    ("epsilon_sigma", {"epsilon_sigma": [0, 10.5]}),
    ("epsilon_sigma", {"epsilon_sigma": ["0"]}),
    ("epsilon_sigma", {"epsilon_sigma": [True]}),
    ("epsilon_sigma", {"epsilon_sigma": [0] * 1001}),
    ("epsilon_sigma", {"epsilon_sigma": 1e999}),
    ("min_confidence", {"min_confidence": -0.1}),
    ("min_confidence", {"min_confidence": 1.1}),
    ("min_confidence", {"min_confidence": "0.5"}),
    ("min_confidence", {"min_confidence": 0.5}),
    ("start", {"start": [0, 0]}),
    ("goal", {"goal": [0, 0]}),
    ("start", {"start": "[0, 0]"}),
    ("start", {"start": [[0, 0]]}),
    ("start", {"model": "cspace-sampler@path", "goal": [0, 0]}),
    ("goal", {"model": "cspace-sampler@path", "start": [0, 0]}),
    ("start", {"model": "cspace-sampler@path", "start": [0], "goal": [0, 0]}),
    ("goal", {"model": "cspace-sampler@path", "start": [0, 0], "goal": [0, 0, 0]}),
    ("goal", {"model": "cspace-sampler@path", "start": [0, 0], "goal": [0, None]}),
    ("image", {"image": "not base64!"}),
    ("image", {"image": IMAGE[:-1]}),
    ("image", {"image": None}),
    ("image", {"image": [1, 2]}),
    ("seeds", {"seeds": 3}),
    ("", {"": 3}),
]


@pytest.mark.parametrize(("field", "change"), WRONG_FIELDS, ids=lambda value: str(value)[:40])
def test_a_wrong_value_in_json_is_422_and_named(api: ApiClient, field: str, change: dict[str, Any]) -> None:
    body = json.dumps({"image": IMAGE, "n": 3, **change}).replace("Infinity", "1e999")
    answer = api.post("/sample", content=body.encode(), headers={"content-type": "application/json"})
    problem = assert_problem(answer, 422, "invalid-value")
    assert field in problem["detail"]
    assert "expected" in problem
    assert "got" in problem
    assert_answers(api)


WRONG_PARTS: list[tuple[str, list[tuple[str, Any]]]] = [
    ("image", []),
    ("image", [("image", (None, IMAGE))]),
    ("image", [("image", ("a.png", PNG)), ("image", ("b.png", PNG))]),
    ("n", [("image", PNG), ("n", (None, "many"))]),
    ("n", [("image", PNG), ("n", (None, "1_0"))]),
    ("n", [("image", PNG), ("n", (None, "2.0"))]),
    ("n", [("image", PNG), ("n", (None, ""))]),
    ("n", [("image", PNG), ("n", (None, "3")), ("n", (None, "3"))]),
    ("n", [("image", PNG), ("n", ("n.txt", b"3"))]),
    ("seed", [("image", PNG), ("seed", (None, "18446744073709551616"))]),
    ("seed", [("image", PNG), ("seed", (None, "seven"))]),
    ("epsilon_sigma", [("image", PNG), ("epsilon_sigma", (None, "nan"))]),
    ("epsilon_sigma", [("image", PNG), ("epsilon_sigma", (None, "inf"))]),
    ("epsilon_sigma", [("image", PNG), ("epsilon_sigma", (None, "1e99"))]),
    ("epsilon_sigma", [("image", PNG), ("epsilon_sigma", (None, "0")), ("epsilon_sigma", (None, "11"))]),
    ("min_confidence", [("image", PNG), ("min_confidence", (None, "2"))]),
    ("start", [("image", PNG), ("start", (None, "3"))]),
    ("colour", [("image", PNG), ("colour", (None, "red"))]),
    ("picture", [("image", PNG), ("picture", ("a.png", PNG))]),
]


@pytest.mark.parametrize(("field", "parts"), WRONG_PARTS, ids=lambda value: str(value)[-60:])
def test_a_wrong_value_in_a_form_is_422_and_named(
    api: ApiClient, field: str, parts: list[tuple[str, Any]]
) -> None:
    answer = api.post("/sample", files=parts or [("n", (None, "3"))])
    problem = assert_problem(answer, 422, "invalid-value")
    assert field in problem["detail"]
    assert_answers(api)


def test_several_wrong_fields_are_all_reported(api: ApiClient) -> None:
    answer = api.post("/sample", json={"n": 0, "seed": -1, "colour": 1})
    problem = assert_problem(answer, 422, "invalid-value")
    assert {item["field"] for item in problem["errors"]} == {"image", "n", "seed", "colour"}


IMAGES: dict[str, Callable[[], bytes]] = {
    "empty": lambda: b"",
    "text": lambda: b"hello",
    "signature only": lambda: PNG[:8],
    "cut": lambda: PNG[: len(PNG) // 2],
    "JPEG": lambda: saved(Image.new("RGB", (48, 48)), "JPEG"),
    "GIF": lambda: saved(Image.new("P", (48, 48)), "GIF"),
    "16 bit": lambda: saved(Image.fromarray(np.zeros((48, 48), np.uint16))),
    "animated": lambda: saved(
        Image.new("RGB", (48, 48)), save_all=True, append_images=[Image.new("RGB", (48, 48), "red")]
    ),
    "not square": lambda: saved(Image.new("RGB", (48, 49))),
    "too small": lambda: saved(Image.new("RGB", (15, 15))),
    "too large": lambda: saved(Image.new("RGB", (2049, 2049))),
    "bomb": lambda: claimed_size(50_000, 50_000),
    "false size": lambda: claimed_size(2048, 2048),
    "zero": lambda: claimed_size(0, 0),
}


@pytest.mark.parametrize("name", sorted(IMAGES))
@pytest.mark.parametrize("form", ["multipart", "json"])
def test_a_picture_that_is_not_acceptable_is_422(api: ApiClient, name: str, form: str) -> None:
    data = IMAGES[name]()
    if form == "json":
        answer = api.post("/sample", json={"image": base64.b64encode(data).decode()})
    else:
        answer = api.post("/sample", files={"image": ("scenario.png", data, "image/png")})
    assert_problem(answer, 422, "invalid-image")
    assert_answers(api)
