"""How far long work is."""

import pytest

from services.commands import Estimate, Progress, time_left


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


@pytest.mark.parametrize(
    ("seconds", "words"),
    [
        (None, ""),
        (0.0, ", almost done"),
        (5.1, ", about 10 s left"),
        (60.0, ", about 60 s left"),
        (61.0, ", about 2 min left"),
        (7200.0, ", about 2.0 h left"),
    ],
)
def test_times_are_told_in_round_words(seconds, words):
    assert time_left(seconds) == words
