"""Forms and JSON, right and wrong: problems name the field, and the server answers the next request."""

import json
import struct
import time
import zlib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import httpx
import numpy as np
import pytest

from cspace.files import encode_png
from cspace.worlds.spatial.camera import encode_depth
from inference_api.limits import MAX_BODY_BYTES
from inference_api.request_body import MAX_FIELD_BYTES, MAX_FIELDS, MAX_FILES, MAX_JSON_BYTES
from tests.inference_api.answers import IMAGE, PNG, assert_answers, assert_problem
from tests.inference_api.client import ApiClient

JSON = {"content-type": "application/json"}
PATH = {"model": "cspace-sampler@path"}
ENDS = PATH | {"start": [0, 0], "goal": [0, 0]}
WRONG: dict[str, list[object]] = {
    "n": [0, -1, 20_001, 2.5, True, "30", None, 10**300],
    "model": [3, "", "../secret", "a/b/c", "a@b@c", "cspace-sampler/0", "cspace-sampler/-1", "x" * 400],
    "seed": [-1, 2**64, str(2**64), "-1", "0x1", "²", 1.5, True],
    "epsilon_sigma": [[], -0.1, [0, 10.5], ["0"], [True], [0] * 1001],
    # The model has no validity head.
    "min_confidence": [-0.1, 1.1, "0.5", 0.5],
    "start": ["[0, 0]", [[0, 0]], [0, 0]],
    "goal": [[0, 0]],
    "image": ["not base64!", IMAGE[:-1], None, [1, 2]],
    "robot": ["", "two link", "-two", f"{'a' * 64}\n"],
    "seeds": [3],
    "": [3],
}
OF_PATHS = [
    ("start", PATH | {"goal": [0, 0]}),
    ("goal", PATH | {"start": [0, 0]}),
    ("start", ENDS | {"start": [0]}),
    ("goal", ENDS | {"goal": [0, None]}),
]


def test_a_wrong_value_in_json_is_422_and_named(api: ApiClient) -> None:
    cases = [(field, {field: value}) for field, values in WRONG.items() for value in values]
    for field, change in cases + OF_PATHS:
        problem = assert_problem(
            api.post("/sample", json={"image": IMAGE, "n": 3, **change}), 422, "invalid-value"
        )
        assert field in problem["detail"], change
        assert {"expected", "got"} <= set(problem)
    assert_answers(api)


FORMS: list[tuple[str, list[tuple[str, Any]]]] = [
    ("image", [("n", (None, "3"))]),
    ("image", [("image", ("a.png", PNG)), ("image", ("b.png", PNG))]),
    ("n", [("image", PNG), ("n", (None, "1_0"))]),
    ("n", [("image", PNG), ("n", (None, "3")), ("n", (None, "3"))]),
    # Words of an exhausted machine, which only its own errors may be taken for.
    ("n", [("image", PNG), ("n", (None, "can't start new thread, bad_alloc"))]),
    ("seed", [("image", PNG), ("seed", (None, "seven"))]),
    ("epsilon_sigma", [("image", PNG), ("epsilon_sigma", (None, "nan"))]),
    ("epsilon_sigma", [("image", PNG), ("epsilon_sigma", (None, "0")), ("epsilon_sigma", (None, "11"))]),
    ("start", [("image", PNG), ("start", (None, "3"))]),
    ("picture", [("image", PNG), ("picture", ("a.png", PNG))]),
]


def test_a_wrong_value_in_a_form_is_422_and_named(api: ApiClient) -> None:
    for field, parts in FORMS:
        problem = assert_problem(api.post("/sample", files=parts), 422, "invalid-value")
        assert field in problem["detail"], parts
    assert_answers(api)


SPELLINGS: dict[str, list[tuple[str, Any]]] = {
    "a file of JSON, as Spring's and a Blob": [("image", PNG), ("n", ("blob", b"3", "application/json"))],
    "a part that curl reads from a file": [("image", PNG), ("epsilon_sigma", ("e.json", b"[0, 1]"))],
    "brackets of PHP": [("image[]", PNG), ("n", (None, "3")), ("epsilon_sigma[0]", (None, "0"))],
    "a list that JavaScript joined": [("image", PNG), ("epsilon_sigma", (None, "0,0.5,1e-05"))],
    "a list of a shell": [("image", PNG), ("epsilon_sigma", (None, "0 0.5"))],
    "Java's array": [("image", PNG), ("epsilon_sigma", (None, "[0.0, 1.0E-5]"))],
    "Qt's part without a file name": [("image", (None, PNG))],
    "a canvas": [("image", (None, f"data:image/png;base64,{IMAGE}"))],
    "Python's nothing and a text as a file": [("image", PNG), ("seed", ("seed.txt", b"7"))],
}


@pytest.mark.parametrize("name", SPELLINGS)
def test_what_other_languages_send_is_taken(api: ApiClient, name: str) -> None:
    answer = api.post("/sample", files=[*SPELLINGS[name], ("model", (None, "pretrained"))])
    assert answer.status_code == 200, answer.text


def test_json_of_other_languages_is_taken(api: ApiClient) -> None:
    wrapped = "\r\n".join(IMAGE[at : at + 76] for at in range(0, len(IMAGE), 76))
    pictures = [f"data:image/png;base64,{IMAGE}", wrapped, IMAGE.replace("+", "-").replace("/", "_")]
    bodies = [json.dumps({"image": one, "n": 3, "model": "pretrained"}) for one in pictures]
    bodies += [bodies[0].replace("/", r"\/"), "\ufeff" + bodies[0]]
    for body in bodies:
        answer = api.post("/sample", content=body.encode(), headers=JSON)
        assert answer.status_code == 200, answer.text


def claimed_size(width: int, height: int) -> bytes:
    """A PNG whose header claims a size that its data does not have."""
    header = b"IHDR" + struct.pack(">IIBBBBB", width, height, 8, 2, 0, 0, 0)
    return PNG[:8] + struct.pack(">I", 13) + header + struct.pack(">I", zlib.crc32(header)) + PNG[33:]


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
    assert_problem(api.post("/sample", files={"image": IMAGES[name]}), 422, "invalid-image")
    assert_answers(api)


def test_another_media_type_is_415(api: ApiClient) -> None:
    kinds = ("text/plain", "image/png", "application/x-www-form-urlencoded", "application/jsonp", "nonsense")
    gzipped = {"content-type": "application/json", "content-encoding": "gzip"}
    for headers in ({}, *({"content-type": kind} for kind in kinds), gzipped):
        answer = api.post("/sample", content=json.dumps({"image": IMAGE}).encode(), headers=headers)
        problem = assert_problem(answer, 415, "unsupported-media-type")
        assert "multipart/form-data" in problem["expected"]


END = b"--b--\r\n"
LONG_JSON = MAX_JSON_BYTES - 200
FORM = "multipart/form-data; boundary=b"
IMAGE_PART = b'form-data; name="image"; filename="a.png"'
EPSILON, FILE = b'form-data; name="epsilon_sigma"', b'form-data; name="a"; filename="b"'


def part(value: bytes, disposition: bytes = b'form-data; name="n"', *headers: bytes) -> bytes:
    return b"\r\n".join([b"--b", b"Content-Disposition: " + disposition, *headers, b"", value, b""])


def filled(unit: bytes, size: int = MAX_BODY_BYTES - 200) -> bytes:
    return unit * (size // len(unit))


def posted(api: ApiClient, body: bytes, content_type: str = FORM) -> httpx.Response:
    return api.post("/sample", content=body, headers={"content-type": content_type.encode("latin-1")})


def test_a_character_set_is_never_looked_up(api: ApiClient) -> None:
    body = part(PNG, IMAGE_PART) + part(b"3") + part(b"pretrained", b'form-data; name="model"') + END
    for charset in ("utf-16", "punycode", "rot13", "nothing"):
        assert posted(api, body, f"{FORM}; charset={charset}").status_code == 200


COSTLY: dict[str, tuple[str, bytes]] = {
    "beginnings of boundaries": (FORM, part(b"1") + filled(b"\r\n--b-\r") + END),
    "boundaries that go on": (FORM, part(b"1") + filled(b"\r\n--bx") + b"\r\n" + END),
    "empty parts": (FORM, filled(b"--b\r\n\r\n\r\n") + END),
    "half-quoted dispositions": (FORM, part(b"1", b'form-data; name="x"; ' + b'";' * 2000) * 1090 + END),
    "many headers": (FORM, part(b"1", EPSILON, *[b"a: " + b"b" * 500] * 7) * 1090 + END),
    "a wide array": (FORM, part(b"[" + b"[]," * 20_000 + b"[]]", b'form-data; name="start"') + END),
    "empty lists": ("application/json", b'{"start":[' + filled(b"[],", LONG_JSON) + b"[]]}"),
    "no base64": ("application/json", b'{"image":"' + filled(b"AAA=") + b'"}'),
    "unknown names": (
        "application/json",
        b"{" + b",".join(b'"%d":0' % index for index in range(100_000)) + b"}",
    ),
    "wrong rows": ("application/json", b'{"configurations":[[' + filled(b"null,", LONG_JSON) + b"0]]}"),
}


@pytest.mark.parametrize("name", COSTLY)
def test_no_body_costs_more_than_a_few_seconds_of_a_processor(api: ApiClient, name: str) -> None:
    media_type, body = COSTLY[name]
    assert len(body) <= MAX_BODY_BYTES
    began = time.process_time()
    answer = api.post("/validity", content=body, headers={"content-type": media_type})
    assert answer.status_code in (400, 422)
    assert time.process_time() - began < 2.0
    assert len(answer.content) < 20_000


@pytest.mark.parametrize("unit", [b"[],", b"{},", b'"ab",', b"0.5,", b"[0,0],"])
def test_json_of_1_mib_takes_less_than_64_mib_and_longer_one_is_not_parsed(
    api: ApiClient, unit: bytes
) -> None:
    Path("/proc/self/clear_refs").write_text("5", encoding="ascii")
    before = memory_mib("VmRSS")
    body = b'{"configurations":[' + filled(unit, LONG_JSON) + b"0]}"
    assert_problem(api.post("/validity", content=body, headers=JSON), 422, "invalid-value")
    assert memory_mib("VmHWM") - before < 64
    body = b'{"configurations":[' + filled(unit) + b"0]}"
    problem = assert_problem(api.post("/validity", content=body, headers=JSON), 413, "body-too-large")
    assert "form" in problem["remedy"]
    assert_answers(api)


def memory_mib(name: str) -> float:
    rows = Path("/proc/self/status").read_text(encoding="ascii").splitlines()
    return next(int(row.split()[1]) for row in rows if row.startswith(name)) / 1024


BOUNDS = {
    "fields": lambda more: part(b"1", EPSILON) * (MAX_FIELDS + more),
    "files": lambda more: part(b"1", FILE) * (MAX_FILES + more),
    "bytes of a field": lambda more: part(b"x" * (MAX_FIELD_BYTES + more)),
}


@pytest.mark.parametrize("name", BOUNDS)
def test_a_bound_is_met_and_not_passed(api: ApiClient, name: str) -> None:
    # What is read is then refused by its fields.
    assert_problem(posted(api, BOUNDS[name](0) + END), 422, "invalid-value")
    assert_problem(posted(api, BOUNDS[name](1) + END), 400, "malformed-body")


NO_OBJECT = {
    "empty": b"",
    "open": b'{"image": ',
    "not UTF-8": b'{"image": "\xff"}',
    "list": b"[]",
    "null": b"null",
    "NaN": b'{"n": NaN}',
    "deep value": b'{"start": ' + b"[" * 100_000 + b"]" * 100_000 + b"}",
    "endless number": b'{"n": ' + b"9" * 10_000 + b"}",
    "UTF-16": '{"n": 3}'.encode("utf-16"),
    "after the end": b"{} {}",
    "half a surrogate pair": b'{"model": "\\ud800"}',
}
TORN = {
    "something before": b"x" + part(b"1") + END,
    "another boundary": part(b"1").replace(b"--b", b"--c") + b"--c--\r\n",
    "no name": part(b"3", b"form-data") + END,
    "garbage": bytes(range(256)) + END,
    "array that is no JSON": part(b"[0, 1", b'form-data; name="start"') + END,
}
MALFORMED = [
    *(("application/json", body) for body in NO_OBJECT.values()),
    *((FORM, body) for body in TORN.values()),
    *((f"multipart/form-data{option}", END) for option in ("", '; boundary=""', "; boundary=\xfc")),
]


@pytest.mark.parametrize(("content_type", "body"), MALFORMED, ids=range(len(MALFORMED)))
def test_a_malformed_body_is_400(api: ApiClient, content_type: str, body: bytes) -> None:
    assert_problem(posted(api, body, content_type), 400, "malformed-body")
    assert_answers(api)


def chunks(total: int) -> Iterator[bytes]:
    for at in range(0, total, 2**20):
        yield bytes(min(2**20, total - at))


def test_a_body_of_more_than_8_mib_is_413_whether_it_is_announced_or_not(api: ApiClient) -> None:
    for content in (bytes(MAX_BODY_BYTES + 1), chunks(MAX_BODY_BYTES + 1)):
        answer = api.post("/sample", content=content, headers=JSON)
        assert ("content-length" in answer.request.headers) is isinstance(content, bytes)
        assert_problem(answer, 413, "body-too-large")
    assert_problem(posted(api, part(bytes(MAX_BODY_BYTES), IMAGE_PART) + END), 413, "body-too-large")
    body = json.dumps({"image": IMAGE, "n": 3}).encode()
    whole = body + b" " * (MAX_JSON_BYTES - len(body) + len(IMAGE) + 2)
    assert api.post("/sample", content=whole, headers=JSON).status_code == 200


def test_an_unknown_model_page_or_method_is_named(api: ApiClient) -> None:
    for model in ("nobody", "nobody/1", "cspace-sampler@nobody", "cspace-sampler/99", "pretrained/1"):
        answer = api.post("/sample", files={"image": PNG}, data={"model": model})
        assert "remedy" in assert_problem(answer, 404, "unknown-model")
    assert_problem(api.get("/nowhere"), 404, "not-found")
    answer = api.get("/sample")
    assert_problem(answer, 405, "method-not-allowed")
    assert answer.headers["allow"] == "POST"
