"""Forms that cost more than they should, that clients really send, and that nobody may send."""

import tempfile
import time
from collections.abc import Iterator
from contextlib import suppress
from typing import Any

import httpx
import pytest
from fastapi import Request

from cspace.png import encode_png
from inference_api.bodies.multipart_form import (
    MAX_FIELD_BYTES,
    MAX_FORM_FIELDS,
    MAX_FORM_FILES,
    MAX_PART_HEADER_BYTES,
    MAX_SEMICOLONS,
    Part,
    is_boundary,
    read_parts,
)
from inference_api.bodies.request_body import MAX_CONTENT_TYPE, RawFields, parse_fields, read_fields
from inference_api.guards.body_limit import MAX_BODY_BYTES
from inference_api.problems import RequestError
from tests.bundles import picture
from tests.cspace.png_files import chunk
from tests.inference_api.answers import PNG, assert_answers, assert_problem
from tests.inference_api.client import ApiClient

END = b"--b--\r\n"


def part(value: bytes, disposition: bytes = b'form-data; name="n"', *headers: bytes) -> bytes:
    lines = [b"--b", b"Content-Disposition: " + disposition, *headers, b"", value, b""]
    return b"\r\n".join(lines)


def filled(unit: bytes, size: int = MAX_BODY_BYTES - 200) -> bytes:
    return unit * (size // len(unit))


def posted(api: ApiClient, body: bytes, content_type: str) -> httpx.Response:
    return api.post("/sample", content=body, headers={"content-type": content_type})


@pytest.mark.parametrize("charset", ["utf-16", "punycode", "idna", "rot13", "cp037", "nothing", "utf-8"])
def test_a_character_set_is_never_looked_up(api: ApiClient, charset: str) -> None:
    image = part(PNG, b'form-data; name="image"; filename="a.png"')
    body = image + part(b"3") + part(b"pretrained", b'form-data; name="model"') + END
    answer = posted(api, body, f"multipart/form-data; boundary=b; charset={charset}")
    assert answer.status_code == 200, answer.text
    assert len(answer.json()["samples"]) == 3


@pytest.mark.parametrize(
    "body",
    [
        part(b"\xff"),
        part("ß".encode("latin-1"), b'form-data; name="model"'),
        part(b"3", b'form-data; name="\xfc"'),
        part(b"\xed\xa0\x80"),
    ],
    ids=["text", "latin", "name", "surrogate"],
)
def test_names_and_texts_are_utf_8(api: ApiClient, body: bytes) -> None:
    problem = assert_problem(
        posted(api, body + END, "multipart/form-data; boundary=b; charset=latin-1"), 400, "malformed-body"
    )
    assert "UTF-8" in problem["expected"]


def test_a_large_file_never_goes_to_the_disk(api: ApiClient, monkeypatch: pytest.MonkeyPatch) -> None:
    def fail(*_: object, **__: object) -> None:
        pytest.fail("a file was opened")

    monkeypatch.setattr(tempfile, "TemporaryFile", fail)
    monkeypatch.setattr(tempfile.SpooledTemporaryFile, "rollover", fail)
    data = encode_png(picture())
    large = data[:33] + chunk(b"tEXt", bytes(3 * 2**20)) + data[33:]
    answer = api.post("/sample", files={"image": large}, data={"n": "3", "model": "pretrained"})
    assert answer.status_code == 200, answer.text


class _Body:
    def __init__(self, content_type: str, body: bytes) -> None:
        self._scope = {"type": "http", "headers": [(b"content-type", content_type.encode())]}
        self._body = body

    async def receive(self) -> dict[str, Any]:
        return {"type": "http.request", "body": self._body, "more_body": False}

    def read(self) -> RawFields:
        reading = read_fields(Request(self._scope, self.receive))
        try:
            reading.send(None)
        except StopIteration as stop:
            found: RawFields = stop.value
            return found
        raise AssertionError("it waited")


def test_on_the_event_loop_a_body_is_not_looked_at() -> None:
    torn = bytes(1000)
    assert _Body("multipart/form-data; boundary=b", torn).read() == RawFields(torn, b"b")
    assert _Body("application/json", torn).read() == RawFields(torn, None)


COSTLY = {
    "beginnings of boundaries": part(b"1") + filled(b"\r\n--b-\r") + END,
    "boundaries that go on": part(b"1") + filled(b"\r\n--bx") + b"\r\n" + END,
    "a boundary behind spaces": b"--b" + filled(b" ") + b"\r\n" + END,
    "a boundary before spaces": part(b"1") + b"--b" + filled(b" ") + b"\r\n" + END,
    "empty parts": filled(b"--b\r\n\r\n\r\n") + END,
    "line ends": part(filled(b"\r\n")) + END,
    "digits that are no number": part(b"1" * 65_000 + b"x", b'form-data; name="epsilon_sigma"') * 120 + END,
    "odd dispositions": part(b"1", b'form-data; name="x"; ' + b"; =" * 1300) * 1990 + END,
    "half-quoted dispositions": part(b"1", b'form-data; name="x"; ' + b'";' * 2000) * 1990 + END,
    "many headers": part(b"1", b'form-data; name="epsilon_sigma"', *[b"a: " + b"b" * 500] * 7) * 1990 + END,
    "a header without an end": b"--b\r\n" + filled(b"a") + b"\r\n" + END,
    "spaces before a header": b"--b\r\na:" + filled(b" ") + b"\r\n\r\n" + END,
    "a preamble": b"\r\n" + filled(b"-\r") + END,
    "an epilogue": part(b"1") + END + filled(b"\r\n--b"),
    "a deep array": part(b"[" * 65_000, b'form-data; name="start"') + END,
    "a wide array": part(b"[" + b"[]," * 20_000 + b"[]]", b'form-data; name="start"') + END,
}


@pytest.mark.parametrize("name", COSTLY)
def test_no_form_costs_more_than_half_a_second_of_a_processor(name: str) -> None:
    assert len(COSTLY[name]) <= MAX_BODY_BYTES
    began = time.thread_time()
    with suppress(RequestError):
        parse_fields(RawFields(COSTLY[name], b"b"))
    assert time.thread_time() - began < 0.5


def many(count: int, disposition: bytes = b'form-data; name="epsilon_sigma"') -> bytes:
    return part(b"1", disposition) * count + END


BOUNDS = {
    "fields": (many(MAX_FORM_FIELDS), many(MAX_FORM_FIELDS + 1)),
    "files": tuple(many(MAX_FORM_FILES + more, b'form-data; name="a"; filename="b"') for more in (0, 1)),
    "bytes of a field": tuple(part(b"x" * (MAX_FIELD_BYTES + more)) + END for more in (0, 1)),
    "headers": tuple(part(b"1", b'form-data; name="n"', *[b"a: b"] * (7 + more)) + END for more in (0, 1)),
    "bytes of headers": tuple(
        part(b"1", b'form-data; name="n"', b"a: " + b"x" * (MAX_PART_HEADER_BYTES - 39 + more)) + END
        for more in (0, 1)
    ),
    "semicolons": tuple(
        part(b"1", b'form-data; name="n"' + b";" * (MAX_SEMICOLONS - 1 + more)) + END for more in (0, 1)
    ),
}


@pytest.mark.parametrize("name", BOUNDS)
def test_a_bound_is_met_and_not_passed(name: str) -> None:
    most, more = BOUNDS[name]
    assert read_parts(most, b"b")
    with pytest.raises(RequestError, match="malformed"):
        read_parts(more, b"b")


@pytest.mark.parametrize(
    "disposition",
    [
        b'form-data; name="image"; filename="a.png"',
        b'form-data; name="image"; filename="a \\"b\\"; c.png"',
        b'form-data; name="image"; filename="a %22b%22.png"',
        'form-data; name="image"; filename="ä.png"; filename*=UTF-8\'\'%C3%A4.png'.encode(),
        b"form-data; name=\"image\"; filename*=utf-8''%C3%A4.png",
        b"form-data; name=image; filename=a.png",
        b'form-data; filename=""; name="image"',
        b'FORM-DATA ; NAME="image" ; FILENAME="C:\\a.png"',
    ],
)
def test_files_as_clients_name_them_are_files(disposition: bytes) -> None:
    body = part(PNG, disposition, b"Content-Type: image/png") + END
    assert read_parts(body, b"b") == [Part("image", PNG)]


def test_the_parts_come_as_they_were_sent() -> None:
    tricky = b"\r\n--\r\n--c\r\n\r\n" + bytes(range(256))
    body = part(tricky, b'form-data; name="a"; filename="b"') + part("π ".encode()) + part(b"") + b"--b--"
    assert read_parts(b"\r\n" + body + b"what comes behind", b"b") == [
        Part("a", tricky),
        Part("n", "π "),
        Part("n", ""),
    ]
    assert read_parts(END, b"b") == []


@pytest.mark.parametrize(
    "body",
    [part(b"1"), part(b"1")[:-2] + b"--b--", part(b"1") + b"--b-", b"--b", b"x" + part(b"1") + END],
    ids=["no end", "an end within a line", "half an end", "a beginning", "something before"],
)
def test_a_form_that_does_not_end_or_begin_is_refused(body: bytes) -> None:
    with pytest.raises(RequestError, match=r"torn|malformed"):
        read_parts(body, b"b")


@pytest.mark.parametrize(
    ("boundary", "fits"),
    [
        (b"b", True),
        (b"----WebKitFormBoundaryAbC123", True),
        (b"'()+_,-./:=? x", True),
        (b"x" * 70, True),
        (b"x" * 71, False),
        (b"", False),
        (b"x ", False),
        (b"\xfc", False),
        (b'"', False),
        (b"x\r\n", False),
    ],
)
def test_boundaries_are_those_of_rfc_2046(api: ApiClient, boundary: bytes, fits: bool) -> None:
    assert is_boundary(boundary) is fits


@pytest.fixture
def after(api: ApiClient) -> Iterator[None]:
    yield
    assert_answers(api)


@pytest.mark.usefixtures("after")
def test_a_boundary_that_is_none_is_400_and_a_long_media_type_415(api: ApiClient) -> None:
    for boundary in ("x" * 71, '""', '"x "', "\xfc"):
        answer = api.post(
            "/sample",
            content=END,
            headers={"content-type": f"multipart/form-data; boundary={boundary}".encode("latin-1")},
        )
        assert_problem(answer, 400, "malformed-body")
    long = "application/json; " + "x" * MAX_CONTENT_TYPE
    assert_problem(posted(api, b"{}", long), 415, "unsupported-media-type")
    assert_problem(posted(api, b"{}", "application/json; " + "x" * 100), 422, "invalid-value")
