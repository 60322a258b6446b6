import pytest

from cspace.errors import BundleError, ConfigError, ModelNotFoundError, ScenarioError
from services.commands import Estimate, Progress, report_error


@pytest.mark.parametrize(
    ("error", "code"),
    [
        (ConfigError("no"), 2),
        (ModelNotFoundError("no"), 2),
        (ScenarioError("no"), 1),
        (BundleError("no"), 1),
    ],
)
def test_the_exit_code_is_that_of_the_errors_kind(error, code, capsys):
    assert report_error(error, ConfigError, ModelNotFoundError) == code
    assert capsys.readouterr() == ("", "error: no\n")


def test_a_program_tells_its_name(capsys):
    assert report_error(ConfigError("no"), program="search") == 1
    assert capsys.readouterr().err == "search: no\n"


class Clock:
    """Stands still until it is moved."""

    now = 100.0

    def __call__(self) -> float:
        return self.now


def test_progress_is_told_in_lines_where_there_is_no_terminal():
    lines = []
    with Progress("planning", 2, lines.append) as progress:
        progress.advance()
        progress.advance()
    assert lines == ["planning: 2/2"]


def test_the_estimate_goes_by_the_pace_of_what_this_attempt_has_done():
    clock = Clock()
    estimate = Estimate(100, done=50, clock=clock)
    clock.now += 1.0
    assert estimate.left(51) == ""
    clock.now += 9.0
    assert [estimate.left(done) for done in (50, 60, 100)] == ["", ", about 40 s left", ""]
