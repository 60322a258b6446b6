"""What metrics, log and traces say after known requests."""

import json
import logging
from collections.abc import Iterator, Mapping
from datetime import datetime
from pathlib import Path
from urllib.parse import quote

import pytest
from prometheus_client.parser import text_string_to_metric_families

from cspace.bundle import Bundle
from inference_api.problems import PROBLEMS
from inference_api.telemetry import SECURITY_HEADERS, JsonFormatter
from tests.inference_api.answers import PNG, assert_answers, assert_problem
from tests.inference_api.client import ApiClient
from tests.inference_api.conftest import StartApi
from tests.inference_api.fake_registry import CountingRegistry

Series = tuple[str, frozenset[tuple[str, str]]]


def scrape(api: ApiClient) -> dict[Series, float]:
    answer = api.get("/metrics")
    assert answer.headers["content-type"].startswith("text/plain; version=0.0.4")
    return {
        (sample.name, frozenset(sample.labels.items())): sample.value
        for family in text_string_to_metric_families(answer.text)
        for sample in family.samples
    }


def increase(before: Mapping[Series, float], after: Mapping[Series, float]) -> dict[Series, float]:
    """What has changed: the metrics are those of the process, which tests share."""
    found = {series: value - before.get(series, 0.0) for series, value in after.items()}
    return {series: value for series, value in found.items() if value}


def value(found: Mapping[Series, float], name: str, /, **labels: str) -> float:
    return found[name, frozenset(labels.items())]


def labelled(found: Mapping[Series, float], name: str, label: str) -> set[str]:
    return {dict(labels)[label] for series, labels in found if series == name}


def fail(*_: object, **__: object) -> None:
    raise ZeroDivisionError("inner words")


def test_requests_are_counted_by_template_method_and_status(api: ApiClient) -> None:
    before = scrape(api)
    for path in ("/models", "/models?x=1", "/health/live", "/docs/assets/swagger-ui.css", "/sample"):
        api.get(path)
    for number in range(5):
        api.get(f"/nothing/{number}")
    found = increase(before, scrape(api))
    for route, status, count in (
        ("/models", "200", 2),
        ("/health/live", "200", 1),
        ("/docs/assets", "200", 1),
        ("/sample", "405", 1),
        ("unknown", "404", 5),
    ):
        assert value(found, "cspace_requests_total", route=route, method="GET", status=status) == count
    for _ in range(2):
        assert value(scrape(api), "cspace_requests_in_flight") == 1


def test_no_client_can_add_names(api: ApiClient) -> None:
    found = []
    for number in range(20):
        api._call(lambda number=number: api._client.request(f"METHOD{number}", f"/models/{number}"))
        api.post("/sample", files={"image": PNG}, data={"model": f"no-{number}", f"field-{number}": "1"})
        api.post("/sample", files={"image": PNG}, data={"model": f"no-{number}"})
        found.append(scrape(api).keys())
    # The first scrape is itself counted by the second.
    assert found[1] == found[-1]
    assert "other" in labelled(scrape(api), "cspace_requests_total", "method")


def test_failures_are_counted_by_problem_type(api: ApiClient, monkeypatch: pytest.MonkeyPatch) -> None:
    before = scrape(api)
    api.post("/sample", files={"image": PNG}, data={"n": "0"})
    api.post("/sample", files={"image": PNG}, data={"n": "many"})
    api.post("/sample", files={"image": b"no PNG"})
    api.post("/sample", files={"image": PNG}, data={"model": "nobody"})
    api.post("/sample", content=b"{", headers={"content-type": "application/json"})
    api.post("/sample", content=bytes(9 * 2**20), headers={"content-type": "application/json"})
    api.get("/sample")
    with monkeypatch.context() as patch:
        patch.setattr(Bundle, "answer", fail)
        assert api.post("/sample", files={"image": PNG}).status_code == 500
    expected = {
        "invalid-value": 2.0,
        "invalid-image": 1.0,
        "unknown-model": 1.0,
        "malformed-body": 1.0,
        "body-too-large": 1.0,
        "method-not-allowed": 1.0,
        "internal-error": 1.0,
    }
    after = scrape(api)
    found = increase(before, after)
    reasons = labelled(found, "cspace_failures_total", "reason")
    assert {name: value(found, "cspace_failures_total", reason=name) for name in reasons} == expected
    assert labelled(after, "cspace_failures_total", "reason") == {problem.name for problem in PROBLEMS}


def test_stages_and_acceptance_are_those_of_the_answers(own_api: ApiClient) -> None:
    before = scrape(own_api)
    fields = {"model": "cspace-sampler@scored", "min_confidence": "0.5", "n": "50", "seed": "1"}
    answers = [own_api.post("/sample", files={"image": PNG}, data=fields).json() for _ in range(2)]
    own_api.post("/sample", files={"image": PNG}, data={"n": "0"})
    found = increase(before, scrape(own_api))
    for stage in ("decode", "encode", "generate", "total"):
        assert value(found, "cspace_stage_seconds_count", stage=stage) == 2
        total = sum(answer["timing_ms"][stage] for answer in answers) / 1e3
        assert value(found, "cspace_stage_seconds_sum", stage=stage) == pytest.approx(total)
    total = sum(answer["acceptance"] for answer in answers)
    assert value(found, "cspace_acceptance_ratio_sum") == pytest.approx(total)


def test_reloads_and_the_model_in_service_follow_the_registry(
    start_api: StartApi, registry: CountingRegistry, bundles: dict[str, Path]
) -> None:
    api = start_api(registry)
    before = scrape(api)
    assert labelled(before, "cspace_model_info", "fallback") == {"true"}
    registry.add(bundles["plain"], "champion")
    api.refresh()
    registry.add(bundles["other"], "champion", digest="0" * 64)
    api.refresh()
    found = scrape(api)
    digest = Bundle.load(bundles["plain"]).digest
    model = {"name": "cspace-sampler", "version": "1", "digest": digest, "fallback": "false"}
    assert value(found, "cspace_model_info", **model) == 1
    assert labelled(found, "cspace_model_info", "version") == {"1"}
    registry.drop_alias("champion")
    api.refresh()
    found = increase(before, scrape(api))
    for outcome in ("served", "removed", "refused"):
        assert value(found, "cspace_model_reloads_total", outcome=outcome) == 1


class Lines(logging.Handler):
    """Keeps the formatted lines."""

    def __init__(self) -> None:
        super().__init__()
        self.setFormatter(JsonFormatter())
        self.lines: list[str] = []

    def emit(self, record: logging.LogRecord) -> None:
        self.lines.append(self.format(record))


@pytest.fixture
def lines() -> Iterator[list[str]]:
    logger, handler = logging.getLogger("inference_api"), Lines()
    level = logger.level
    logger.addHandler(handler)
    logger.setLevel(logging.INFO)
    yield handler.lines
    logger.setLevel(level)
    logger.removeHandler(handler)


def test_a_request_for_samples_leaves_one_line_with_its_facts(api: ApiClient, lines: list[str]) -> None:
    fields = {"model": "cspace-sampler/1", "n": "7", "seed": "18446744073709551615"}
    answer = api.post("/sample", files={"image": PNG}, data=fields, headers={"x-request-id": "robot-1.7"})
    assert answer.headers["x-request-id"] == "robot-1.7"
    (line,) = (json.loads(line) for line in lines)
    assert datetime.fromisoformat(line.pop("time")).tzinfo is not None
    assert line.pop("duration_ms") > 0
    assert line == {
        "level": "info",
        "logger": "inference_api.access",
        "message": "POST /sample 200",
        "request_id": "robot-1.7",
        "method": "POST",
        "route": "/sample",
        "status": 200,
        "model": "cspace-sampler/1",
        "n": 7,
        "seed": "18446744073709551615",
        "shortfall": 0,
    }


def test_a_failure_that_nobody_foresaw_is_500_without_its_inner_words_which_the_log_has(
    api: ApiClient, lines: list[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    with monkeypatch.context() as patch:
        patch.setattr(Bundle, "answer", fail)
        answer = api.post("/sample", files={"image": PNG}, headers={"x-request-id": "fails"})
    assert_problem(answer, 500, "internal-error")
    assert "inner words" not in answer.text
    assert answer.headers["x-request-id"] == "fails"
    failure, access = [json.loads(line) for line in lines]
    assert failure["request_id"] == access["request_id"] == "fails"
    assert failure["level"] == "error"
    assert "inner words" in failure["exception"]
    assert (access["status"], access["reason"]) == (500, "internal-error")
    assert_answers(api)


@pytest.mark.parametrize("error", [MemoryError(), OSError(24, "Too many open files")], ids=repr)
def test_a_machine_with_nothing_left_is_503(
    api: ApiClient, monkeypatch: pytest.MonkeyPatch, error: Exception
) -> None:
    def exhausted(*_: object, **__: object) -> None:
        raise error

    with monkeypatch.context() as patch:
        patch.setattr(Bundle, "answer", exhausted)
        assert_problem(api.post("/sample", files={"image": PNG}), 503, "out-of-resources")
    assert_answers(api)


def test_the_line_has_no_place_for_a_clients_words(api: ApiClient, lines: list[str]) -> None:
    words = "level=info\nforged"
    api.get(f"/{quote(words)}", headers={"x-request-id": "forged id", "user-agent": "forged agent"})
    api.post("/sample", files={"image": PNG}, data={"model": words, words: "1"})
    assert len(lines) == 2
    assert not any("forged" in line or "\n" in line for line in lines)


def test_a_plain_id_is_kept_and_another_one_replaced_by_a_fresh_one(api: ApiClient) -> None:
    for sent in ("a", "x" * 128, "A-Za-z0-9._-"):
        assert api.get("/nothing", headers={"x-request-id": sent}).headers["x-request-id"] == sent
    for sent in ("", "a b", "é", "x" * 129, "a;b", "<script>"):
        headers = {"x-request-id": sent.encode("latin-1")}
        found = {api.get("/health/live", headers=headers).headers["x-request-id"] for _ in range(2)}
        assert {len(one) for one in found} == {32}
        assert len(found) == 2


def test_every_answer_has_the_security_headers(api: ApiClient) -> None:
    answers = {"/health/live": 200, "/models": 200, "/metrics": 200, "/nothing": 404, "/sample": 405}
    for path, status in answers.items():
        answer = api.get(path)
        assert answer.status_code == status
        assert {name: answer.headers.get(name) for name in SECURITY_HEADERS} == SECURITY_HEADERS
