"""What benchmarks share: a command line whose help is the module's documentation, and spreads of figures."""

import argparse
import statistics
from collections.abc import Iterable


def arguments(description: str | None) -> argparse.ArgumentParser:
    """A parser that shows a module's docstring as it is written."""
    return argparse.ArgumentParser(
        description=description, formatter_class=argparse.RawDescriptionHelpFormatter
    )


def spread(values: Iterable[float], digits: int = 1) -> str:
    """Median and range."""
    values = list(values)
    middle, low, high = statistics.median(values), min(values), max(values)
    return f"{middle:.{digits}f} ({low:.{digits}f} to {high:.{digits}f})"
