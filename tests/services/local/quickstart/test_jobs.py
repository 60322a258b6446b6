import pytest

from cspace.errors import JobError
from services.local.jobs import LAST_LINES, LOOKS, RayJobs, follow
from services.local.processes import free_ports
from services.local.settings import Settings
from tests.fakes.jobs import FakeJobs


def no_pause(seconds: float) -> None:
    """The fake moves on by being looked at."""


def test_lines_are_shown_once_as_they_come_and_never_in_halves() -> None:
    jobs = FakeJobs(
        [
            ("PENDING", ""),
            ("RUNNING", "one\ntw"),
            ("RUNNING", "one\ntwo\nthree\n"),
            ("SUCCEEDED", "one\ntwo\nthree\nfour"),
        ]
    )
    shown: list[str] = []
    assert follow(jobs, "job-1", shown.append, no_pause) == "one\ntwo\nthree\nfour"
    assert shown == ["one", "two", "three", "four"]


def test_a_few_missed_questions_do_not_end_the_following() -> None:
    pauses: list[float] = []
    jobs = FakeJobs([("SUCCEEDED", "one\n")], misses=LOOKS - 1)
    assert follow(jobs, "job-1", lambda line: None, pauses.append) == "one\n"
    assert len(pauses) == LOOKS - 1


def test_a_head_that_is_gone_ends_the_following() -> None:
    with pytest.raises(JobError, match="misses"):
        follow(FakeJobs([("RUNNING", "")], misses=LOOKS), "job-1", lambda line: None, no_pause)


def test_colours_of_workers_are_left_out() -> None:
    shown: list[str] = []
    jobs = FakeJobs(
        [("RUNNING", "\x1b[36m(trial pid=1)"), ("SUCCEEDED", "\x1b[36m(trial pid=1)\x1b[0m step 1\n")]
    )
    assert follow(jobs, "job-1", shown.append, no_pause) == "(trial pid=1) step 1\n"
    assert shown == ["(trial pid=1) step 1"]


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
