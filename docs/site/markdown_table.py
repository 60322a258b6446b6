"""Tables and code in Markdown."""

from collections.abc import Iterable, Iterator, Sequence


def table(head: Sequence[str], rows: Iterable[Sequence[str]]) -> Iterator[str]:
    """The lines of a table.

    Args:
        head: of its columns.
        rows: their cells, in Markdown.
    """
    yield _line(head)
    yield _line(["---"] * len(head))
    yield from map(_line, rows)


def code(text: str) -> str:
    """Text in code font; nothing for no text."""
    return f"`{text}`" if text else ""


def _line(cells: Sequence[str]) -> str:
    escaped = (" ".join(cell.split()).replace("|", "\\|") for cell in cells)
    return f"| {' | '.join(escaped)} |"
