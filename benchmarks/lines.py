"""Results of a benchmark, a JSON object a line, so that one that was stopped goes on where it was."""

import json
import statistics
from collections.abc import Callable, Iterable
from pathlib import Path


def read(path: Path) -> list[dict]:
    return [json.loads(line) for line in path.read_text().splitlines()] if path.exists() else []


def append(path: Path, row: dict) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    with path.open("a", encoding="utf-8") as file:
        file.write(json.dumps(row) + "\n")


def measured(path: Path, row: dict, measure: Callable[[], dict]) -> None:
    """Measure what a row describes and add it to the results, unless it stands there already."""
    if any(row.items() <= one.items() for one in read(path)):
        return
    found = row | measure()
    append(path, found)
    print(found, flush=True)


def spread(values: Iterable[float], digits: int = 1) -> str:
    """Median and range."""
    values = list(values)
    middle, low, high = statistics.median(values), min(values), max(values)
    return f"{middle:.{digits}f} ({low:.{digits}f} to {high:.{digits}f})"
