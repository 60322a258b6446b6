"""Every error of the contract but wrong values, provoked; after each the server answers the next request."""

import json
from collections.abc import Iterator
from pathlib import Path

import pytest

from inference_api.limits import MAX_BODY_BYTES
from inference_api.requests import MAX_CONTENT_TYPE
from tests.inference_api.answers import IMAGE, PNG, assert_answers, assert_problem
from tests.inference_api.client import ApiClient
from tests.inference_api.conftest import StartApi
from tests.inference_api.fake_registry import CountingRegistry


def test_an_unknown_model_is_404(api: ApiClient) -> None:
    for model in ("nobody", "nobody/1", "cspace-sampler@nobody", "cspace-sampler/99", "pretrained/1"):
        answer = api.post("/sample", files={"image": PNG}, data={"model": model})
        assert "remedy" in assert_problem(answer, 404, "unknown-model")
    assert_answers(api)


def test_an_unknown_page_and_a_wrong_method_are_problems_too(api: ApiClient) -> None:
    assert_problem(api.get("/nowhere"), 404, "not-found")
    answer = api.get("/sample")
    assert_problem(answer, 405, "method-not-allowed")
    assert answer.headers["allow"] == "POST"


def test_another_media_type_is_415(api: ApiClient) -> None:
    kinds = ("text/plain", "image/png", "application/x-www-form-urlencoded", "application/jsonp", "nonsense")
    gzipped = {"content-type": "application/json", "content-encoding": "gzip"}
    long = {"content-type": "application/json; " + "x" * MAX_CONTENT_TYPE}
    for headers in ({}, *({"content-type": kind} for kind in kinds), gzipped, long):
        answer = api.post("/sample", content=json.dumps({"image": IMAGE}).encode(), headers=headers)
        problem = assert_problem(answer, 415, "unsupported-media-type")
        assert "multipart/form-data" in problem["expected"]
    assert_answers(api)


def chunks(total: int) -> Iterator[bytes]:
    size = 1 << 20
    for at in range(0, total, size):
        yield bytes(min(size, total - at))


@pytest.mark.parametrize("media_type", ["application/json", "multipart/form-data; boundary=limit"])
def test_a_body_of_more_than_8_mib_is_413_whether_it_is_announced_or_not(
    api: ApiClient, media_type: str
) -> None:
    for content in (bytes(MAX_BODY_BYTES + 1), chunks(MAX_BODY_BYTES + 1)):
        answer = api.post("/sample", content=content, headers={"content-type": media_type})
        assert ("content-length" in answer.request.headers) is isinstance(content, bytes)
        problem = assert_problem(answer, 413, "body-too-large")
        assert problem["expected"] == f"at most {8 * 1024 * 1024} bytes"
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
    metrics = api.get("/metrics").text
    assert "cspace_model_info{" not in metrics
    assert 'cspace_failures_total{reason="no-model"} 3.0' in metrics


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
