"""Jobs on a Ray head: what is shown while they run, their results, their pictures."""

import json
from collections.abc import Iterator
from pathlib import Path

import httpx
import pytest

from cspace.errors import JobError, RegistryError
from services.local.jobs import (
    LAST_LINES,
    LOOKS,
    EvaluationResult,
    RayJobs,
    TrainingResult,
    fetch_pictures,
    follow,
    last_result,
)
from services.local.processes import free_ports
from services.local.settings import Settings
from tests.fakes.jobs import FakeJobs


def no_pause(seconds: float) -> None:
    """The fake moves on by being looked at."""


@pytest.mark.parametrize(
    ("looks", "lines"),
    [
        (["", "one\ntw", "one\ntwo\nthree\n", "one\ntwo\nthree\nfour"], ["one", "two", "three", "four"]),
        # Colours of workers are left out.
        (["\x1b[36m(trial pid=1)", "\x1b[36m(trial pid=1)\x1b[0m step 1\n"], ["(trial pid=1) step 1"]),
    ],
)
def test_lines_are_shown_once_as_they_come_and_never_in_halves(looks: list[str], lines: list[str]) -> None:
    *before, last = looks
    jobs = FakeJobs([*(("RUNNING", log) for log in before), ("SUCCEEDED", last)])
    shown: list[str] = []
    assert follow(jobs, "job-1", shown.append, no_pause).splitlines() == lines
    assert shown == lines


def test_a_few_missed_questions_do_not_end_the_following() -> None:
    pauses: list[float] = []
    jobs = FakeJobs([("SUCCEEDED", "one\n")], misses=LOOKS - 1)
    assert follow(jobs, "job-1", lambda line: None, pauses.append) == "one\n"
    assert len(pauses) == LOOKS - 1


def test_a_head_that_is_gone_ends_the_following() -> None:
    with pytest.raises(JobError, match="misses"):
        follow(FakeJobs([("RUNNING", "")], misses=LOOKS), "job-1", lambda line: None, no_pause)


@pytest.mark.parametrize("state", ["FAILED", "STOPPED"])
def test_a_failed_job_is_an_error_with_the_end_of_its_log_and_where_the_rest_is(state: str) -> None:
    log = "".join(f"line {number}\n" for number in range(100))
    with pytest.raises(JobError) as raised:
        follow(FakeJobs([(state, log)]), "job-1", lambda line: None, no_pause)
    message = str(raised.value)
    assert state in message
    assert "line 99" in message
    assert f"line {99 - LAST_LINES}\n" not in message
    assert "ray job logs job-1" in message


def test_a_jobs_api_that_does_not_answer_is_a_job_error(settings: Settings) -> None:
    (port,) = free_ports(1)
    jobs = RayJobs(Settings(settings.home, settings.root, ray_port=port))
    with pytest.raises(JobError, match="make status"):
        jobs.submit("true")


TRAINING = {
    "run_id": "r1",
    "model": "cspace-sampler",
    "version": 3,
    "digest": "d1",
    "data_digest": "d2",
    "metrics": {"critic_loss": 0.5},
    "figures": ["vae-losses"],
}
EVALUATION = {
    "run_id": "r2",
    "version": 3,
    "promoted": True,
    "reasons": ["beats uniform"],
    "metrics": {"precision": 0.85},
    "figures": ["gallery-test.png"],
}


def log(fields: object) -> str:
    return f"working\nRESULT {json.dumps(fields)}\n"


def test_the_last_result_of_a_training_names_its_version() -> None:
    result = last_result(log(TRAINING | {"version": 2}) + "more\n" + log(TRAINING), TrainingResult)
    assert result.reference == "cspace-sampler/3"
    assert (result.run_id, result.digest, result.figures) == ("r1", "d1", ("vae-losses",))


def test_an_evaluation_result_holds_verdict_and_reasons() -> None:
    result = last_result(log(EVALUATION), EvaluationResult)
    assert (result.promoted, result.reasons) == (True, ("beats uniform",))
    assert result.metrics == {"precision": 0.85}


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("the RESULT {} comes later\nRESULTS {}\n", "no result"),
        ("RESULT {", "the job's result"),
        ("RESULT []", "the job's result"),
        (log({name: value for name, value in EVALUATION.items() if name != "reasons"}), "reasons"),
        (log(EVALUATION | {"promoted": "false"}), "promoted"),
    ],
)
def test_what_is_no_result_is_an_error(text: str, words: str) -> None:
    with pytest.raises(JobError, match=words):
        last_result(text, EvaluationResult)


@pytest.fixture
def mlflow(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """A tracking server whose run has one figure."""

    def serve(request: httpx.Request) -> httpx.Response:
        known = request.url.path == "/get-artifact" and request.url.params["path"] == "figures/losses.png"
        return httpx.Response(200, content=b"png") if known else httpx.Response(404)

    with httpx.Client(transport=httpx.MockTransport(serve)) as client:
        monkeypatch.setattr(httpx, "get", lambda url, *, params, **_: client.get(url, params=params))
        yield


@pytest.mark.parametrize("name", ["losses", "losses.png", "../../losses.png"])
@pytest.mark.usefixtures("mlflow")
def test_a_figure_is_copied_by_its_name_into_the_folder(tmp_path: Path, name: str) -> None:
    folder = tmp_path / "figures"
    found = fetch_pictures("http://mlflow", "r1", [name], folder)
    assert found == [folder / "losses.png"]
    assert found[0].read_bytes() == b"png"


@pytest.mark.usefixtures("mlflow")
def test_a_figure_that_is_not_there_is_an_error_that_names_it(tmp_path: Path) -> None:
    with pytest.raises(RegistryError, match=r"figures/other\.png of run r1"):
        fetch_pictures("http://mlflow", "r1", ["other"], tmp_path)
