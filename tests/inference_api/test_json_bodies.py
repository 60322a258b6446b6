"""JSON that would keep the interpreter to itself: counted before it is parsed."""

import json
import time
from contextlib import suppress

import pytest

from cspace.errors import CspaceError
from inference_api.bodies.bounded_json import MAX_DIGITS, MAX_MARKS, MAX_TENSOR_MARKS, load_json
from inference_api.bodies.request_body import RawFields, parse_fields
from inference_api.guards.body_limit import MAX_BODY_BYTES
from inference_api.open_inference.tensor_request import read_request
from inference_api.open_inference.tensors import read_tensors
from inference_api.pages.validation import validate_request
from inference_api.problems import RequestError
from tests.inference_api.client import ApiClient
from tests.inference_api.tensor_client import infer

MOST = MAX_BODY_BYTES - 40


def repeated(unit: bytes, count: int) -> bytes:
    return b"[" + b",".join([unit] * count) + b"]"


def tensor(numbers: bytes) -> bytes:
    shape = numbers.count(b",") + 1
    return b'{"inputs":[{"name":"t","datatype":"FP32","shape":[%d],"data":%b}]}' % (shape, numbers)


def sample(body: bytes) -> None:
    validate_request(parse_fields(RawFields(body)))


def inference(body: bytes) -> None:
    request = read_request(body)
    read_tensors(request.inputs, b"")


FEW, MANY = MAX_MARKS - 10, MAX_TENSOR_MARKS - 40
COSTLY = {
    "empty lists": (sample, b'{"start":' + repeated(b"[]", MOST // 3) + b"}"),
    "brackets": (sample, b"[" * MOST),
    "commas": (sample, b"," * MOST),
    "base64": (sample, b'{"image":"' + b"A" * (MOST - MOST % 4) + b'"}'),
    "no base64": (sample, b'{"image":"' + b"!" * MOST + b'"}'),
    "escapes": (sample, b'{"image":"' + b"\\u0041" * (MOST // 6) + b'"}'),
    "escaped line ends": (sample, b'{"image":"' + b"x\\n" * (MOST // 3) + b'"}'),
    "four bytes a character": (sample, b'{"image":"' + "😀".encode() * (MOST // 4) + b'"}'),
    "digits of a seed": (sample, b'{"seed":"' + b"1" * MOST + b'"}'),
    "a long name": (sample, b'{"' + b"x" * MOST + b'":0}'),
    "unknown names": (sample, b"{" + b",".join(b'"k%d":0' % index for index in range(FEW // 2)) + b"}"),
    "wrong numbers": (sample, b'{"epsilon_sigma":' + repeated(b"[]", FEW // 2) + b"}"),
    "long whole numbers": (sample, repeated(b"9" * MAX_DIGITS, FEW)),
    "whole numbers of 4300 digits": (sample, repeated(b"9" * 4300, MOST // 4301)),
    "long fractions": (sample, b'{"start":' + repeated(b"0." + b"3" * 1500 + b"e-300", FEW) + b"}"),
    "spaces": (sample, b" " * MOST + b"{}"),
    "tensors of empty lists": (inference, tensor(repeated(b"[]", MANY // 2))),
    "tensors of fractions": (inference, tensor(repeated(b"2.22507385850720113605e-308", MANY))),
    "tensors of whole numbers": (inference, tensor(repeated(b"9" * 70, MANY))),
    "more tensors": (inference, tensor(repeated(b"0", MOST // 2 - 100))),
    "parameters": (
        inference,
        b'{"parameters":{' + b",".join(b'"k%d":[]' % index for index in range(MANY // 3)) + b"}}",
    ),
    "shapes": (
        inference,
        b'{"inputs":[{"name":"t","datatype":"FP32","shape":' + repeated(b"[]", MANY // 2) + b"}]}",
    ),
}


@pytest.mark.parametrize("name", COSTLY)
def test_no_json_costs_more_than_half_a_second_of_a_processor(name: str) -> None:
    read, body = COSTLY[name]
    assert len(body) <= MAX_BODY_BYTES
    began = time.thread_time()
    with suppress(CspaceError):
        read(body)
    assert time.thread_time() - began < 0.5


@pytest.mark.parametrize("mark", [b",", b":", b"[", b"{"])
def test_too_many_values_are_refused_before_they_are_parsed(
    monkeypatch: pytest.MonkeyPatch, mark: bytes
) -> None:
    def fail(*_: object, **__: object) -> None:
        pytest.fail("it was parsed")

    with pytest.raises(RequestError, match="is not JSON"):
        load_json("it", mark * MAX_MARKS)
    monkeypatch.setattr(json, "loads", fail)
    with pytest.raises(RequestError, match="too many values"):
        load_json("it", mark * (MAX_MARKS + 1))


def test_whole_numbers_have_as_many_digits_as_nobody_needs() -> None:
    assert load_json("it", b"9" * MAX_DIGITS) == 10**MAX_DIGITS - 1
    for digits in (MAX_DIGITS + 1, 4301, 10**6):
        with pytest.raises(RequestError, match="is not JSON"):
            load_json("it", b"9" * digits)


@pytest.mark.parametrize("member", ["n", "seed", "image", "model", "epsilon_sigma", "start", "goal"])
@pytest.mark.parametrize(
    "value", [10**900, -(10**900), "\ud800", "x" * 10**6], ids=["up", "down", "half", "long"]
)
def test_odd_values_are_refused_wherever_they_stand(api: ApiClient, member: str, value: object) -> None:
    # In escapes, for half a surrogate pair has no other form.
    content = json.dumps({member: value}).encode()
    answer = api.post("/sample", content=content, headers={"content-type": "application/json"})
    assert answer.status_code == 422
    assert len(answer.content) < 5000
    answer = infer(api, "pretrained", content=b'{"inputs": [], "parameters": %b}' % content)
    assert answer.status_code == 400
    assert len(answer.content) < 5000
