"""How a command ends that fails: a line for people, an exit code for programs."""

import argparse
import math
import sys

from cspace.errors import CspaceError


def report_error(error: CspaceError, *wrong: type[CspaceError], program: str = "error") -> int:
    """Print an error; returns the exit code, 2 for a wrong request and 1 for whatever else failed.

    Args:
        error: that ended the command.
        wrong: the kinds of error that a wrong request ends with.
        program: what the line begins with.
    """
    sys.stderr.write(f"{program}: {error}\n")
    return 2 if isinstance(error, wrong) else 1


def finite(text: str) -> float:
    """The type of an option that is a finite number; ``float`` would take ``inf`` and ``nan``.

    Raises:
        argparse.ArgumentTypeError: it is none, which the parser tells as a wrong use.
    """
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise argparse.ArgumentTypeError(f"expected a finite number, got {text[:80]!r}")
    return value
