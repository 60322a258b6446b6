"""What a job says at its end: a block for people, and the same as JSON in a file."""

import json
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from cspace.errors import StorageError
from cspace.files import replacing

RESULT_FILE = "result.json"


def tell_result(result: Mapping[str, Any], rows: Mapping[str, str], folder: Path) -> None:
    """Keep the result in the job's folder and print it.

    Programs read the file, or the line ``RESULT`` with the same JSON, the last of a log; a terminal has none.

    Args:
        result: plain values.
        rows: of the block, by what they tell.
        folder: of the job.
    """
    path, text = folder / RESULT_FILE, json.dumps(result)
    try:
        with replacing(path, str(path)) as beside:
            beside.write_text(text + "\n", encoding="utf-8")
        told = {**rows, "as JSON": str(path)}
    except StorageError as error:
        # The work is done and registered; a full disk takes the file alone.
        told = {**rows, "as JSON": f"not kept: {error}"}
    width = max(map(len, told))
    lines = ["", "result", *(f"  {name.ljust(width)}  {row}" for name, row in told.items() if row)]
    if not sys.stdout.isatty():
        lines.append(f"RESULT {text}")
    sys.stdout.write("\n".join(lines) + "\n")
    sys.stdout.flush()


def numbers(values: Mapping[str, float], unit: str = "") -> str:
    """Named numbers in a line."""
    return ", ".join(f"{name} {value:.4g}{unit}" for name, value in values.items())
