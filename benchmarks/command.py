"""The command line of a benchmark: its own documentation is its help."""

import argparse
from pathlib import Path


def arguments(description: str | None) -> argparse.ArgumentParser:
    """A parser that shows a module's docstring as it is written."""
    return argparse.ArgumentParser(
        description=description, formatter_class=argparse.RawDescriptionHelpFormatter
    )


def tracked_arguments(description: str | None) -> argparse.ArgumentParser:
    """What all benchmarks with a tracking server take."""
    parser = arguments(description)
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--tracking-uri", required=True)
    return parser
