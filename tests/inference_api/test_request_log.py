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
from tests.inference_api.answers import PNG, assert_answers, assert_problem
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


def test_a_failure_that_nobody_foresaw_is_500_without_its_inner_words_which_the_log_has(
    api: ApiClient, json_lines: list[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    def fail(*_: object, **__: object) -> None:
        raise ZeroDivisionError("inner words")

    headers = {"x-request-id": "fails"}
    infer = {"inputs": [json_input(picture()[None])]}
    with monkeypatch.context() as patch:
        patch.setattr(Bundle, "answer", fail)
        answers = [
            api.post("/sample", files={"image": PNG}, headers=headers),
            api.post("/v2/models/cspace-sampler/infer", json=infer, headers=headers),
        ]
    assert_problem(answers[0], 500, "internal-error")
    assert (answers[1].status_code, set(answers[1].json())) == (500, {"error"})
    for answer in answers:
        assert "inner words" not in answer.text
        assert answer.headers["x-request-id"] == "fails"
        assert answer.headers["x-content-type-options"] == "nosniff"
    lines = [json.loads(line) for line in json_lines]
    assert [line["request_id"] for line in lines] == ["fails"] * 4
    for failure, access in (lines[:2], lines[2:]):
        assert failure["level"] == "error"
        assert "inner words" in failure["exception"]
        assert (access["status"], access["reason"]) == (500, "internal-error")
    assert_answers(api)


def test_the_line_has_no_place_for_a_clients_words(api: ApiClient, lines: list[str]) -> None:
    words = "level=info\nforged"
    api.get(f"/{quote(words)}", headers={"x-request-id": "forged id", "user-agent": "forged agent"})
    api.post("/sample", files={"image": PNG}, data={"model": words, words: "1"})
    assert len(lines) == 2
    assert not any("forged" in line or "\n" in line for line in lines)


def test_a_plain_id_is_kept_and_another_one_replaced_by_a_fresh_one(api: ApiClient) -> None:
    for sent in ("a", "x" * 128, "A-Za-z0-9._-"):
        assert choose_request_id(sent) == sent
    for sent in ("", " ", "a b", "é", "a\n", "x" * 129, "a;b", "<script>"):
        first, second = choose_request_id(sent), choose_request_id(sent)
        assert first != second
        assert len(first) == 32
        if "\n" not in sent:
            answer = api.get("/health/live", headers={"x-request-id": sent.encode("latin-1")})
            assert answer.headers["x-request-id"] not in {sent, ""}
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
