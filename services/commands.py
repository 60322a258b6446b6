"""What commands share: how one ends, a question to its user, numbers among its options, progress."""

import argparse
import json
import math
import sys
import time
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, Self, TypeVar

from pydantic import BaseModel, ValidationError

from cspace.errors import ConfigError, CspaceError, StorageError
from cspace.files import replacing

Settings = TypeVar("Settings", bound=BaseModel)
RESULT_FILE = "result.json"
PREFIX = "RESULT "
"""Of the line for programs."""


def report_error(error: CspaceError, *wrong: type[CspaceError], program: str = "error") -> int:
    """Print an error after the program's name; returns 2 for the errors of a wrong request, 1 for others."""
    sys.stderr.write(f"{program}: {error}\n")
    return 2 if isinstance(error, wrong) else 1


def settings_of(kind: type[Settings]) -> Settings:
    """Settings of the environment; the error of a wrong one names its variable."""
    try:
        return kind()
    except ValidationError as error:
        first = error.errors()[0]
        raise ConfigError(
            f"the setting CSPACE_{str(first['loc'][0]).upper()} does not fit",
            expected=first["msg"].removeprefix("Value error, ").removeprefix("Input should be "),
            got=repr(first["input"])[:200],
            remedy="set it in the environment, or unset it for its default",
        ) from error


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


LINE_EVERY_S = 5.0
# A pace is worth telling after this long.
_KNOWN_AFTER_S = 2.0
_SOON_S = 5.0


class Estimate:
    """How long work will still take, by its pace since the beginning."""

    def __init__(self, total: int, done: int = 0, clock: Callable[[], float] = time.monotonic) -> None:
        self._total, self._first, self._clock, self._began = total, done, clock, clock()

    def left(self, done: int) -> str:
        """What is left after so many pieces, after a comma; empty while nobody knows, and at the end."""
        passed, made = self._clock() - self._began, done - self._first
        if made < 1 or passed < _KNOWN_AFTER_S or done >= self._total:
            return ""
        return time_left(passed / made * (self._total - done))


def time_left(seconds: float | None) -> str:
    """A time in round words after a comma, never zero; empty for None."""
    if seconds is None:
        return ""
    if seconds < _SOON_S:
        return ", almost done"
    if seconds <= 60:
        return f", about {5 * math.ceil(seconds / 5)} s left"
    if seconds < 5400:
        return f", about {math.ceil(seconds / 60)} min left"
    return f", about {seconds / 3600:.1f} h left"


class Progress:
    """Counts pieces of work that are done."""

    def __init__(self, what: str, total: int, show: Callable[[str], None], unit: str = "run") -> None:
        self._what, self._total, self._done, self._show = what, total, 0, show
        self._estimate, self._shown_at = Estimate(total), time.monotonic()
        shape = f"{{desc}}: {{percentage:3.0f}}%|{{bar}}| {{n_fmt}}/{{total_fmt}} {unit}s{{postfix}}"
        from tqdm import tqdm  # noqa: PLC0415 - a server imports this module and shows no progress

        self._bar = tqdm(total=total, desc=what, bar_format=shape) if sys.stderr.isatty() else None

    def advance(self) -> None:
        """One more piece is done."""
        self._done += 1
        left = self._estimate.left(self._done)
        if self._bar is not None:
            self._bar.set_postfix_str(left.removeprefix(", "), refresh=False)
            self._bar.update()
            return
        now = time.monotonic()
        if now - self._shown_at >= LINE_EVERY_S or self._done == self._total:
            self._shown_at = now
            self._show(f"{self._what}: {self._done}/{self._total}{left}")

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        if self._bar is not None:
            self._bar.close()
