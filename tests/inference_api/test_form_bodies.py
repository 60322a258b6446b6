"""Forms that cost more than they should, that clients really send, and that nobody may send."""

import tempfile
import time

import httpx
import pytest

from cspace.png import encode_png
from inference_api.limits import MAX_BODY_BYTES
from inference_api.requests import MAX_FIELD_BYTES, MAX_FIELDS, MAX_FILES, MAX_SEMICOLONS
from tests.bundles import picture
from tests.cspace.png_files import chunk
from tests.inference_api.answers import PNG, assert_answers, assert_problem
from tests.inference_api.client import ApiClient

END = b"--b--\r\n"
FORM = "multipart/form-data; boundary=b"
IMAGE_PART = b'form-data; name="image"; filename="a.png"'


def part(value: bytes, disposition: bytes = b'form-data; name="n"', *headers: bytes) -> bytes:
    lines = [b"--b", b"Content-Disposition: " + disposition, *headers, b"", value, b""]
    return b"\r\n".join(lines)


def filled(unit: bytes, size: int = MAX_BODY_BYTES - 200) -> bytes:
    return unit * (size // len(unit))


def posted(api: ApiClient, body: bytes, content_type: str = FORM) -> httpx.Response:
    return api.post("/sample", content=body, headers={"content-type": content_type.encode("latin-1")})


def test_a_character_set_is_never_looked_up(api: ApiClient) -> None:
    body = part(PNG, IMAGE_PART) + part(b"3") + part(b"pretrained", b'form-data; name="model"') + END
    for charset in ("utf-16", "punycode", "idna", "rot13", "cp037", "nothing", "utf-8"):
        answer = posted(api, body, f"{FORM}; charset={charset}")
        assert answer.status_code == 200, answer.text
        assert len(answer.json()["samples"]) == 3


def test_a_large_file_never_goes_to_the_disk(api: ApiClient, monkeypatch: pytest.MonkeyPatch) -> None:
    def fail(*_: object, **__: object) -> None:
        pytest.fail("a file was opened")

    monkeypatch.setattr(tempfile, "TemporaryFile", fail)
    monkeypatch.setattr(tempfile.SpooledTemporaryFile, "rollover", fail)
    data = encode_png(picture())
    large = data[:33] + chunk(b"tEXt", bytes(3 * 2**20)) + data[33:]
    answer = api.post("/sample", files={"image": large}, data={"n": "3", "model": "pretrained"})
    assert answer.status_code == 200, answer.text


EPSILON = b'form-data; name="epsilon_sigma"'
COSTLY = {
    "beginnings of boundaries": part(b"1") + filled(b"\r\n--b-\r") + END,
    "boundaries that go on": part(b"1") + filled(b"\r\n--bx") + b"\r\n" + END,
    "a boundary behind spaces": b"--b" + filled(b" ") + b"\r\n" + END,
    "a boundary before spaces": part(b"1") + b"--b" + filled(b" ") + b"\r\n" + END,
    "empty parts": filled(b"--b\r\n\r\n\r\n") + END,
    "line ends": part(filled(b"\r\n")) + END,
    "digits that are no number": part(b"1" * 65_000 + b"x", EPSILON) * 120 + END,
    "odd dispositions": part(b"1", b'form-data; name="x"; ' + b"; =" * 1300) * 1090 + END,
    "half-quoted dispositions": part(b"1", b'form-data; name="x"; ' + b'";' * 2000) * 1090 + END,
    "many headers": part(b"1", EPSILON, *[b"a: " + b"b" * 500] * 7) * 1090 + END,
    "a header without an end": b"--b\r\n" + filled(b"a") + b"\r\n" + END,
    "spaces before a header": b"--b\r\na:" + filled(b" ") + b"\r\n\r\n" + END,
    "a preamble": b"\r\n" + filled(b"-\r") + END,
    "an epilogue": part(b"1") + END + filled(b"\r\n--b"),
    "a deep array": part(b"[" * 65_000, b'form-data; name="start"') + END,
    "a wide array": part(b"[" + b"[]," * 20_000 + b"[]]", b'form-data; name="start"') + END,
}


@pytest.mark.parametrize("name", COSTLY)
def test_no_form_costs_more_than_half_a_second_of_a_processor(api: ApiClient, name: str) -> None:
    assert len(COSTLY[name]) <= MAX_BODY_BYTES
    began = time.process_time()
    assert posted(api, COSTLY[name]).status_code in (400, 422)
    assert time.process_time() - began < 0.5


FILE = b'form-data; name="a"; filename="b"'
BOUNDS = {
    "fields": lambda more: part(b"1", EPSILON) * (MAX_FIELDS + more),
    "files": lambda more: part(b"1", FILE) * (MAX_FILES + more),
    "bytes of a field": lambda more: part(b"x" * (MAX_FIELD_BYTES + more)),
    "semicolons": lambda more: part(b"1", b'form-data; name="n"' + b";" * (MAX_SEMICOLONS - 1 + more)),
}


@pytest.mark.parametrize("name", BOUNDS)
def test_a_bound_is_met_and_not_passed(api: ApiClient, name: str) -> None:
    # What is read is then refused by its fields.
    assert_problem(posted(api, BOUNDS[name](0) + END), 422, "invalid-value")
    problem = assert_problem(posted(api, BOUNDS[name](1) + END), 400, "malformed-body")
    assert "as an .npy file or the request as JSON" in problem["remedy"]
    assert_answers(api)


DISPOSITIONS = [
    IMAGE_PART,
    b'form-data; name="image"; filename="a \\"b\\"; c.png"',
    b'form-data; name="image"; filename="a %22b%22.png"',
    'form-data; name="image"; filename="ä.png"; filename*=UTF-8\'\'%C3%A4.png'.encode(),
    b"form-data; name=image; filename=a.png",
    b'form-data; filename=""; name="image"',
    b'FORM-DATA ; NAME="image" ; FILENAME="C:\\a.png"',
]


def test_files_as_clients_name_them_are_files(api: ApiClient) -> None:
    for disposition in DISPOSITIONS:
        body = b"\r\n" + part(PNG, disposition, b"Content-Type: image/png") + part(b"2")
        answer = posted(api, body + b"--b--what follows")
        assert answer.status_code == 200, answer.text
        assert len(answer.json()["samples"]) == 2


START = b'form-data; name="start"'
TORN = {
    "nothing": b"",
    "no end": part(b"1"),
    "an end within a line": part(b"1")[:-2] + b"--b--",
    "half an end": part(b"1") + b"--b-",
    "a beginning": b"--b",
    "something before": b"x" + part(b"1") + END,
    "another boundary": part(b"1").replace(b"--b", b"--c") + b"--c--\r\n",
    "no name": part(b"3", b"form-data") + END,
    "no headers": b"--b\r\n\r\n3\r\n" + END,
    "garbage": bytes(range(256)) + END,
    "array that is no JSON": part(b"[0, 1", START) + END,
    "array with more behind it": part(b'[0], "n": 1', START) + END,
}


@pytest.mark.parametrize("name", TORN)
def test_a_form_that_is_torn_is_400(api: ApiClient, name: str) -> None:
    assert_problem(posted(api, TORN[name]), 400, "malformed-body")
    assert_answers(api)


def test_a_boundary_that_rfc_2046_excludes_is_400(api: ApiClient) -> None:
    options = ("", *(f"; boundary={text}" for text in ("x" * 71, '""', '"x "', "\xfc")))
    for option in options:
        assert_problem(posted(api, END, f"multipart/form-data{option}"), 400, "malformed-body")
    assert_answers(api)
