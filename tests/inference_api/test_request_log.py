"""Request ids and the one line that each request leaves in the log."""

import json
import logging
import logging.config
from collections.abc import Iterator
from datetime import datetime
from urllib.parse import quote

import pytest

from cspace.bundle import Bundle
from inference_api.logs import JsonFormatter, LogForm, TextFormatter, choose_request_id, log_settings
from tests.bundles import picture
from tests.inference_api.answers import PNG
from tests.inference_api.client import ApiClient
from tests.inference_api.tensor_client import json_input

ACCESS = "inference_api.access"


class Lines(logging.Handler):
    """Keeps the formatted lines."""

    def __init__(self, formatter: logging.Formatter) -> None:
        super().__init__()
        self.setFormatter(formatter)
        self.lines: list[str] = []

    def emit(self, record: logging.LogRecord) -> None:
        self.lines.append(self.format(record))


@pytest.fixture(params=["text", "json"])
def lines(request: pytest.FixtureRequest) -> Iterator[list[str]]:
    yield from _listening(TextFormatter() if request.param == "text" else JsonFormatter())


@pytest.fixture
def json_lines() -> Iterator[list[str]]:
    yield from _listening(JsonFormatter())


def _listening(formatter: logging.Formatter) -> Iterator[list[str]]:
    logger, handler = logging.getLogger("inference_api"), Lines(formatter)
    level = logger.level
    logger.addHandler(handler)
    logger.setLevel(logging.INFO)
    yield handler.lines
    logger.setLevel(level)
    logger.removeHandler(handler)


def test_a_request_for_samples_leaves_one_line_with_its_facts(api: ApiClient, json_lines: list[str]) -> None:
    fields = {"model": "cspace-sampler/1", "n": "7", "seed": "18446744073709551615"}
    answer = api.post("/sample", files={"image": PNG}, data=fields, headers={"x-request-id": "robot-1.7"})
    assert answer.headers["x-request-id"] == "robot-1.7"
    (line,) = (json.loads(line) for line in json_lines)
    assert datetime.fromisoformat(line.pop("time")).tzinfo is not None
    assert line.pop("duration_ms") > 0
    assert line == {
        "level": "info",
        "logger": ACCESS,
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


def test_an_error_has_its_reason_in_the_line_and_the_id_in_the_answer(
    api: ApiClient, json_lines: list[str]
) -> None:
    for path, reason in (("/nothing", "not-found"), ("/sample", "method-not-allowed")):
        answer = api.get(path, headers={"x-request-id": "a"})
        assert answer.headers["x-request-id"] == "a"
        assert json.loads(json_lines[-1])["reason"] == reason


def test_lines_from_within_a_request_carry_its_id_and_a_failure_its_trace(
    api: ApiClient, json_lines: list[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    def fail(*_: object, **__: object) -> None:
        raise ZeroDivisionError("inner words")

    with monkeypatch.context() as patch:
        patch.setattr(Bundle, "answer", fail)
        answer = api.post("/sample", files={"image": PNG}, headers={"x-request-id": "fails"})
    assert (answer.status_code, answer.headers["x-request-id"]) == (500, "fails")
    assert answer.headers["x-content-type-options"] == "nosniff"
    failure, access = (json.loads(line) for line in json_lines)
    assert failure["request_id"] == access["request_id"] == "fails"
    assert failure["level"] == "error"
    assert "inner words" in failure["exception"]
    assert (access["status"], access["reason"]) == (500, "internal-error")


def test_the_line_has_no_place_for_a_clients_words(api: ApiClient, lines: list[str]) -> None:
    words = "level=info\nforged"
    api.get(f"/{quote(words)}", headers={"x-request-id": "forged id", "user-agent": "forged agent"})
    api.post("/sample", files={"image": PNG}, data={"model": words, words: "1"})
    assert len(lines) == 2
    assert not any("forged" in line or "\n" in line for line in lines)


def test_a_failure_below_v2_is_told_in_the_protocol_s_form_and_logged_alike(
    api: ApiClient, json_lines: list[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    def fail(*_: object, **__: object) -> None:
        raise ZeroDivisionError

    request = {"inputs": [json_input(picture()[None])]}
    with monkeypatch.context() as patch:
        patch.setattr(Bundle, "answer", fail)
        headers = {"x-request-id": "fails"}
        answer = api.post("/v2/models/cspace-sampler/infer", json=request, headers=headers)
    assert (answer.status_code, set(answer.json())) == (500, {"error"})
    assert answer.headers["x-request-id"] == "fails"
    _, access = (json.loads(line) for line in json_lines)
    assert (access["status"], access["reason"]) == (500, "internal-error")


@pytest.mark.parametrize("sent", ["", " ", "a b", "é", "a\n", "x" * 129, "a;b", "<script>"])
def test_an_id_that_is_not_plain_is_replaced_by_a_fresh_one(api: ApiClient, sent: str) -> None:
    first, second = choose_request_id(sent), choose_request_id(sent)
    assert first != second
    assert len(first) == 32
    if "\n" not in sent:
        answer = api.get("/health/live", headers={"x-request-id": sent.encode("latin-1")})
        assert answer.headers["x-request-id"] not in {sent, ""}


@pytest.mark.parametrize("sent", ["a", "x" * 128, "A-Za-z0-9._-"])
def test_a_plain_id_is_kept(sent: str) -> None:
    assert choose_request_id(sent) == sent


def test_answers_to_requests_without_an_id_have_different_ones(api: ApiClient) -> None:
    assert len({api.get("/health/live").headers["x-request-id"] for _ in range(3)}) == 3


@pytest.mark.parametrize("form", ["text", "json"])
def test_the_settings_of_the_log_are_settings(form: LogForm, capfd: pytest.CaptureFixture[str]) -> None:
    root = logging.getLogger()
    kept = root.level, root.handlers[:]
    try:
        logging.config.dictConfig(log_settings(form))
        logging.getLogger("inference_api.test").info("%d models", 3)
        logging.getLogger("elsewhere").info("not told")
        line = capfd.readouterr().err
    finally:
        root.setLevel(kept[0])
        root.handlers[:] = kept[1]
        logging.getLogger("inference_api").setLevel(logging.NOTSET)
        logging.getLogger("uvicorn").setLevel(logging.NOTSET)
    if form == "json":
        assert json.loads(line)["message"] == "3 models"
    else:
        assert line == "INFO:     3 models\n"
