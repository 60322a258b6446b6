"""Tables, rendered for reports and for terminals."""

from collections.abc import Sequence

import pandas as pd

# Rows of cells, the header first.
Table = Sequence[Sequence[str]]


def markdown(table: Table | pd.DataFrame) -> str:
    """The table in Markdown."""
    header, *rows = _rows(table)
    return "\n".join(f"| {' | '.join(row)} |" for row in (header, ["---"] * len(header), *rows))


def aligned(table: Table | pd.DataFrame) -> str:
    """The table for a terminal: columns as wide as their widest cell."""
    rows = _rows(table)
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    lines = ["  ".join(cell.ljust(width) for cell, width in zip(row, widths, strict=True)) for row in rows]
    return "\n".join(line.rstrip() for line in lines)


def _rows(table: Table | pd.DataFrame) -> Table:
    if not isinstance(table, pd.DataFrame):
        return table
    rows = table.map(lambda cell: f"{cell:.4f}" if isinstance(cell, float) else str(cell)).to_numpy()
    return [list(table), *rows.tolist()]
