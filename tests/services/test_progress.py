"""How far long work is."""

from services.progress import Progress


def test_progress_is_told_in_lines_where_there_is_no_terminal():
    lines = []
    with Progress("planning", 2, lines.append) as progress:
        progress.advance()
        progress.advance()
    assert lines[-1].startswith("planning: 2/2, 0 s left")
