"""Every error of the contract but wrong values, provoked; after each the server answers the next request."""

import json
from collections.abc import Iterator
from pathlib import Path

import pytest

from cspace.bundle import Bundle
from inference_api.limits import MAX_BODY_BYTES
from tests.inference_api.answers import IMAGE, PNG, assert_answers, assert_problem
from tests.inference_api.client import ApiClient
from tests.inference_api.conftest import StartApi
from tests.inference_api.fake_registry import CountingRegistry

JSON_BODIES = {
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


@pytest.mark.parametrize("name", sorted(JSON_BODIES))
def test_a_body_that_is_no_json_object_is_400(api: ApiClient, name: str) -> None:
    answer = api.post("/sample", content=JSON_BODIES[name], headers={"content-type": "application/json"})
    assert_problem(answer, 400, "malformed-body")
    assert_answers(api)


@pytest.mark.parametrize("depth", [50, 400, 800, 900, 950])
def test_nesting_that_json_can_still_read_is_an_answer_and_no_crash(api: ApiClient, depth: int) -> None:
    body = b'{"start": ' + b"[" * depth + b"]" * depth + b"}"
    answer = api.post("/sample", content=body, headers={"content-type": "application/json"})
    assert answer.status_code in (400, 422)
    assert_answers(api)


PART = b'--limit\r\nContent-Disposition: form-data; name="n"\r\n\r\n3\r\n'
FORMS = {
    "empty": ("multipart/form-data; boundary=limit", b""),
    "no boundary": ("multipart/form-data", PART + b"--limit--\r\n"),
    "another boundary": ("multipart/form-data; boundary=other", PART + b"--limit--\r\n"),
    "cut": ("multipart/form-data; boundary=limit", PART),
    "no name": (
        "multipart/form-data; boundary=limit",
        b"--limit\r\nContent-Disposition: form-data\r\n\r\n3\r\n--limit--\r\n",
    ),
    "no headers": ("multipart/form-data; boundary=limit", b"--limit\r\n\r\n3\r\n--limit--\r\n"),
    "garbage": ("multipart/form-data; boundary=limit", bytes(range(256)) + b"--limit--"),
    "field too long": (
        "multipart/form-data; boundary=limit",
        b'--limit\r\nContent-Disposition: form-data; name="n"\r\n\r\n' + b"3" * 70_000 + b"\r\n--limit--\r\n",
    ),
    "too many fields": ("multipart/form-data; boundary=limit", PART * 2001 + b"--limit--\r\n"),
    "array that is no JSON": (
        "multipart/form-data; boundary=limit",
        PART.replace(b'"n"', b'"start"').replace(b"\r\n3", b"\r\n[0, 1") + b"--limit--\r\n",
    ),
    "array with more behind it": (
        "multipart/form-data; boundary=limit",
        PART.replace(b'"n"', b'"start"').replace(b"\r\n3", b'\r\n[0], "n": 1') + b"--limit--\r\n",
    ),
}


@pytest.mark.parametrize("name", sorted(FORMS))
def test_a_form_that_is_torn_is_400(api: ApiClient, name: str) -> None:
    media_type, body = FORMS[name]
    answer = api.post("/sample", content=body, headers={"content-type": media_type})
    assert_problem(answer, 400, "malformed-body")
    assert_answers(api)


@pytest.mark.parametrize(
    "model",
    ["nobody", "nobody@champion", "nobody/1", "cspace-sampler@nobody", "cspace-sampler/99", "pretrained/1"],
)
def test_an_unknown_model_is_404(api: ApiClient, model: str) -> None:
    answer = api.post("/sample", files={"image": PNG}, data={"model": model})
    problem = assert_problem(answer, 404, "unknown-model")
    assert "remedy" in problem
    assert_answers(api)


def test_an_unknown_page_and_a_wrong_method_are_problems_too(api: ApiClient) -> None:
    assert_problem(api.get("/nowhere"), 404, "not-found")
    answer = api.get("/sample")
    assert_problem(answer, 405, "method-not-allowed")
    assert answer.headers["allow"] == "POST"
    assert_answers(api)


@pytest.mark.parametrize(
    "headers",
    [
        {},
        {"content-type": "text/plain"},
        {"content-type": "image/png"},
        {"content-type": "application/x-www-form-urlencoded"},
        {"content-type": "application/jsonp"},
        {"content-type": "nonsense"},
        {"content-type": "application/json", "content-encoding": "gzip"},
    ],
    ids=str,
)
def test_another_media_type_is_415(api: ApiClient, headers: dict[str, str]) -> None:
    answer = api.post("/sample", content=json.dumps({"image": IMAGE}).encode(), headers=headers)
    problem = assert_problem(answer, 415, "unsupported-media-type")
    assert "multipart/form-data" in problem["expected"]
    assert_answers(api)


def chunks(total: int) -> Iterator[bytes]:
    size = 1 << 20
    for at in range(0, total, size):
        yield bytes(min(size, total - at))


@pytest.mark.parametrize(
    "media_type", ["application/json", "multipart/form-data; boundary=limit", "text/plain"]
)
def test_a_body_that_announces_more_than_8_mib_is_413(api: ApiClient, media_type: str) -> None:
    answer = api.post("/sample", content=bytes(MAX_BODY_BYTES + 1), headers={"content-type": media_type})
    problem = assert_problem(answer, 413, "body-too-large")
    assert problem["expected"] == f"at most {8 * 1024 * 1024} bytes"
    assert_answers(api)


@pytest.mark.parametrize("media_type", ["application/json", "multipart/form-data; boundary=limit"])
def test_a_body_of_more_than_8_mib_without_a_length_is_413(api: ApiClient, media_type: str) -> None:
    answer = api.post("/sample", content=chunks(MAX_BODY_BYTES + 1), headers={"content-type": media_type})
    assert "content-length" not in answer.request.headers
    assert_problem(answer, 413, "body-too-large")
    assert_answers(api)


def test_a_body_of_exactly_8_mib_is_read(api: ApiClient) -> None:
    body = json.dumps({"image": IMAGE, "n": 3}).encode()
    padded = body + b" " * (MAX_BODY_BYTES - len(body))
    answer = api.post("/sample", content=padded, headers={"content-type": "application/json"})
    assert answer.status_code == 200
    padded_in_chunks = api.post("/sample", content=[padded], headers={"content-type": "application/json"})
    assert padded_in_chunks.status_code == 200


def test_no_model_at_all_is_503_and_not_ready_but_alive(
    start_api: StartApi, registry: CountingRegistry
) -> None:
    api = start_api(registry, shipped=False)
    answer = api.post("/sample", files={"image": PNG})
    assert "promote" in assert_problem(answer, 503, "no-model")["remedy"]
    assert_problem(api.post("/sample", files={"image": PNG}, data={"model": "pretrained"}), 503, "no-model")
    assert_problem(api.get("/health/ready"), 503, "no-model")
    assert api.get("/health/live").json() == {"status": "live"}


def test_a_version_that_fails_its_checks_is_503_and_the_champion_goes_on(
    own_api: ApiClient, registry: CountingRegistry, bundles: dict[str, Path]
) -> None:
    number = registry.add(bundles["other"], digest="0" * 64)
    answer = own_api.post("/sample", files={"image": PNG}, data={"model": f"cspace-sampler/{number}"})
    problem = assert_problem(answer, 503, "no-model")
    assert "refused" in problem["detail"]
    assert own_api.post("/sample", files={"image": PNG}).json()["model"]["version"] == 1


def test_a_registry_that_is_away_is_503_for_versions_that_are_not_here(
    own_api: ApiClient, registry: CountingRegistry
) -> None:
    registry.away = True
    answer = own_api.post("/sample", files={"image": PNG}, data={"model": "cspace-sampler/2"})
    assert_problem(answer, 503, "registry-unavailable")
    assert_answers(own_api)


def test_a_failure_that_nobody_foresaw_is_500_without_its_inner_words(
    api: ApiClient, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fail(*_: object, **__: object) -> None:
        raise ZeroDivisionError("a secret")

    with monkeypatch.context() as patch:
        patch.setattr(Bundle, "answer", fail)
        answer = api.post("/sample", files={"image": PNG})
    assert_problem(answer, 500, "internal-error")
    assert "secret" not in answer.text
    assert_answers(api)
