"""JSON that would keep the interpreter to itself: counted before it is parsed."""

import json
import time

import pytest

from inference_api import requests
from inference_api.limits import MAX_BODY_BYTES
from inference_api.requests import MAX_ESCAPES, MAX_MARKS
from tests.inference_api.answers import IMAGE, assert_answers, assert_problem
from tests.inference_api.client import ApiClient
from tests.inference_api.tensor_client import infer

JSON = {"content-type": "application/json"}
INFER = "/v2/models/pretrained/infer"
MOST = MAX_BODY_BYTES - 40


def repeated(unit: bytes, count: int) -> bytes:
    return b"[" + b",".join([unit] * count) + b"]"


def tensor(numbers: bytes) -> bytes:
    shape = numbers.count(b",") + 1
    return b'{"inputs":[{"name":"t","datatype":"FP32","shape":[%d],"data":%b}]}' % (shape, numbers)


FEW, MANY = 4_990, MAX_MARKS - 40
COSTLY = {
    "empty lists": ("/sample", b'{"start":' + repeated(b"[]", MOST // 3) + b"}"),
    "base64": ("/sample", b'{"image":"' + b"A" * (MOST - MOST % 4) + b'"}'),
    "no base64": ("/sample", b'{"image":"' + b"!" * MOST + b'"}'),
    "escaped line ends": ("/sample", b'{"image":"' + b"x\\n" * (MOST // 3) + b'"}'),
    "four bytes a character": ("/sample", b'{"image":"' + "😀".encode() * (MOST // 4) + b'"}'),
    "digits of a seed": ("/sample", b'{"seed":"' + b"1" * MOST + b'"}'),
    "a long name": ("/sample", b'{"' + b"x" * MOST + b'":0}'),
    "unknown names": ("/sample", b"{" + b",".join(b'"k%d":0' % index for index in range(FEW // 2)) + b"}"),
    "wrong numbers": ("/sample", b'{"epsilon_sigma":' + repeated(b"[]", FEW // 2) + b"}"),
    "long whole numbers": ("/sample", repeated(b"9" * 1_000, FEW)),
    "whole numbers of 4300 digits": ("/sample", repeated(b"9" * 4300, MOST // 4301)),
    "long fractions": ("/sample", b'{"start":' + repeated(b"0." + b"3" * 1500 + b"e-300", FEW) + b"}"),
    "tensors of empty lists": (INFER, tensor(repeated(b"[]", MANY // 2))),
    "tensors of fractions": (
        INFER,
        tensor(repeated(b"2.22507385850720113605e-308", MANY)),
    ),
    "tensors of whole numbers": (INFER, tensor(repeated(b"9" * 70, MANY))),
    "parameters": (
        INFER,
        b'{"parameters":{' + b",".join(b'"k%d":[]' % index for index in range(MANY // 3)) + b"}}",
    ),
    "shapes": (
        INFER,
        b'{"inputs":[{"name":"t","datatype":"FP32","shape":' + repeated(b"[]", MANY // 2) + b"}]}",
    ),
}


@pytest.mark.parametrize("name", COSTLY)
def test_no_json_costs_more_than_half_a_second_of_a_processor(api: ApiClient, name: str) -> None:
    path, body = COSTLY[name]
    assert len(body) <= MAX_BODY_BYTES
    began = time.process_time()
    answer = api.post(path, content=body, headers=JSON)
    assert answer.status_code in (400, 422)
    assert time.process_time() - began < 0.5
    assert len(answer.content) < 6000


MALFORMED = {
    "empty": b"",
    "open": b'{"image": ',
    "not UTF-8": b'{"image": "\xff"}',
    "list": b"[]",
    "number": b"3",
    "null": b"null",
    "NaN": b'{"n": NaN}',
    "deep list": b"[" * 200_000,
    "deep value": b'{"start": ' + b"[" * 100_000 + b"]" * 100_000 + b"}",
    "deep objects": b'{"a":' * 100_000,
    "endless number": b'{"n": ' + b"9" * 10_000 + b"}",
    "UTF-16": '{"n": 3}'.encode("utf-16"),
    "after the end": b"{} {}",
}


@pytest.mark.parametrize("name", MALFORMED)
def test_a_body_that_is_no_json_object_is_400(api: ApiClient, name: str) -> None:
    answer = api.post("/sample", content=MALFORMED[name], headers=JSON)
    assert_problem(answer, 400, "malformed-body")
    assert_answers(api)


def test_nesting_that_json_can_still_read_is_an_answer_and_no_crash(api: ApiClient) -> None:
    for depth in (50, 400, 800, 900, 950):
        body = b'{"start": ' + b"[" * depth + b"]" * depth + b"}"
        assert api.post("/sample", content=body, headers=JSON).status_code in (400, 422)
    assert_answers(api)


def test_too_many_values_are_refused_before_they_are_parsed(
    api: ApiClient, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fail(*_: object, **__: object) -> None:
        pytest.fail("it was parsed")

    for mark in (b",", b":", b"[", b"{"):
        answer = api.post("/sample", content=mark * MAX_MARKS, headers=JSON)
        assert "is not JSON" in assert_problem(answer, 400, "malformed-body")["detail"]
        with monkeypatch.context() as patch:
            patch.setattr(requests, "from_json", fail)
            answer = api.post("/sample", content=mark * (MAX_MARKS + 1), headers=JSON)
        assert "too many values" in assert_problem(answer, 400, "malformed-body")["detail"]


def test_a_text_of_escapes_is_refused_and_a_picture_with_escaped_slashes_is_not(api: ApiClient) -> None:
    text = b'{"model": "' + b"\\n" * (MAX_ESCAPES + 1) + b'"}'
    answer = api.post("/sample", content=text, headers=JSON)
    assert "too many escapes" in assert_problem(answer, 400, "malformed-body")["detail"]
    escaped = json.dumps({"image": IMAGE, "n": 3}).replace("/", "\\/")
    assert api.post("/sample", content=escaped.encode(), headers=JSON).status_code == 200


@pytest.mark.parametrize(
    ("value", "status"),
    [(10**900, 422), (-(10**900), 422), ("\ud800", 400), ("x" * 10**6, 422)],
    ids=["up", "down", "half", "long"],
)
def test_odd_values_are_refused_wherever_they_stand(api: ApiClient, value: object, status: int) -> None:
    for member in ("n", "seed", "image", "model", "epsilon_sigma", "start", "goal"):
        # In escapes, for half a surrogate pair has no other form.
        content = json.dumps({member: value}).encode()
        answer = api.post("/sample", content=content, headers=JSON)
        assert answer.status_code == status, member
        assert len(answer.content) < 5000
        answer = infer(api, "pretrained", content=b'{"inputs": [], "parameters": %b}' % content)
        assert answer.status_code == 400
        assert len(answer.content) < 5000
