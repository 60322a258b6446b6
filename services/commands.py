"""What commands share: how one ends, a question to its user, numbers among its options."""

import argparse
import json
import math
import sys
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

from cspace.errors import ConfigError, CspaceError, StorageError
from cspace.files import replacing

RESULT_FILE = "result.json"
PREFIX = "RESULT "
"""Of the line for programs."""


def report_error(error: CspaceError, *wrong: type[CspaceError], program: str = "error") -> int:
    """Print an error after the program's name; returns 2 for the errors of a wrong request, 1 for others."""
    sys.stderr.write(f"{program}: {error}\n")
    return 2 if isinstance(error, wrong) else 1


def confirmed(question: str) -> bool:
    """Whether the person at the terminal says yes."""
    if not sys.stdin.isatty():
        raise ConfigError("there is nobody to ask", expected="a terminal", remedy="confirm with --yes")
    return input(f"{question} [y/N] ").strip().lower() in {"y", "yes"}


def number(expected: str, low: float, high: float = math.inf, kind: Callable[[str], float] = float) -> Any:
    """The type of an option that is a finite number of ``low`` to ``high``."""

    def parse(text: str) -> float:
        try:
            value = kind(text)
        except ValueError:
            value = math.nan
        if not low <= value <= high or value == math.inf:
            raise argparse.ArgumentTypeError(f"expected {expected}, got {text[:80]!r}")
        return value

    return parse


COUNT, ANY_SEED = number("1 or more", 1, kind=int), number("0 to 2^63 - 1", 0, 2**63 - 1, int)
POSITIVE, SHARE = number("a number above 0", sys.float_info.min), number("0 to 1", 0.0, 1.0)
finite = number("a finite number", -sys.float_info.max)


def report_result(result: Mapping[str, Any], rows: Mapping[str, str], folder: Path | None) -> None:
    """Print a job's result as a block of rows, and keep it as JSON in the job's folder if it has one.

    Programs read the file, or the line ``RESULT`` with the same JSON, the last of a log; a terminal has none.
    """
    text = json.dumps(result)
    shown = dict(rows) if folder is None else {**rows, "as JSON": _kept(text, folder / RESULT_FILE)}
    width = max(map(len, shown))
    lines = ["", "result", *(f"  {name.ljust(width)}  {row}" for name, row in shown.items() if row)]
    if not sys.stdout.isatty():
        lines.append(f"{PREFIX}{text}")
    print("\n".join(lines), flush=True)  # noqa: T201


def _kept(text: str, path: Path) -> str:
    """Where the file lies, in words; the work is done, and a full disk takes the file alone."""
    try:
        with replacing(path, str(path)) as beside:
            path.parent.mkdir(parents=True, exist_ok=True)
            beside.write_text(text + "\n", encoding="utf-8")
    except StorageError as error:
        return f"not kept: {error}"
    return str(path)


def aligned(rows: Sequence[Sequence[str]]) -> str:
    """Rows of cells as columns for a terminal."""
    from tabulate import tabulate  # noqa: PLC0415 - a server imports this module and has no tables

    return tabulate(rows, tablefmt="plain", disable_numparse=True)


def numbers(values: Mapping[str, float], unit: str = "") -> str:
    """Named numbers in a line."""
    return ", ".join(f"{name} {value:.4g}{unit}" for name, value in values.items())
