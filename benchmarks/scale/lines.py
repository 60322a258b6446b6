"""Results of a benchmark, a JSON object a line, so that one that was stopped goes on where it was."""

import argparse
import json
import statistics
from collections.abc import Iterable
from pathlib import Path


def arguments(description: str | None) -> argparse.ArgumentParser:
    """What all benchmarks with a tracking server take."""
    parser = argparse.ArgumentParser(
        description=description, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--tracking-uri", required=True)
    return parser


def read(path: Path) -> list[dict]:
    return [json.loads(line) for line in path.read_text().splitlines()] if path.exists() else []


def append(path: Path, row: dict) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    with path.open("a", encoding="utf-8") as file:
        file.write(json.dumps(row) + "\n")


def spread(values: Iterable[float], digits: int = 1) -> str:
    """Median and range."""
    values = list(values)
    middle, low, high = statistics.median(values), min(values), max(values)
    return f"{middle:.{digits}f} ({low:.{digits}f} to {high:.{digits}f})"
