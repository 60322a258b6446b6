"""What a job says at its end: a block for people, and the same as JSON in a file."""

import json
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from cspace.errors import StorageError
from cspace.files import replacing

RESULT_FILE = "result.json"
PREFIX = "RESULT "
"""Of the line for programs."""


def report_result(result: Mapping[str, Any], rows: Mapping[str, str], folder: Path | None) -> None:
    """Keep the result in the job's folder, which is made if it has to be, and print it.

    Programs read the file, or the line ``RESULT`` with the same JSON, the last of a log; a terminal has none.

    Args:
        result: plain values.
        rows: of the block, by what they tell.
        folder: of the job; None where it has none, then there is no file.
    """
    text = json.dumps(result)
    shown = dict(rows) if folder is None else {**rows, "as JSON": _kept(text, folder / RESULT_FILE)}
    width = max(map(len, shown))
    lines = ["", "result", *(f"  {name.ljust(width)}  {row}" for name, row in shown.items() if row)]
    if not sys.stdout.isatty():
        lines.append(f"{PREFIX}{text}")
    sys.stdout.write("\n".join(lines) + "\n")
    sys.stdout.flush()


def _kept(text: str, path: Path) -> str:
    """Where the file lies, in words; the work is done, and a full disk takes the file alone."""
    try:
        with replacing(path, str(path)) as beside:
            path.parent.mkdir(parents=True, exist_ok=True)
            beside.write_text(text + "\n", encoding="utf-8")
    except StorageError as error:
        return f"not kept: {error}"
    return str(path)


def numbers(values: Mapping[str, float], unit: str = "") -> str:
    """Named numbers in a line."""
    return ", ".join(f"{name} {value:.4g}{unit}" for name, value in values.items())
