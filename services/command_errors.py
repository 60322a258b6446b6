"""What commands share: how one ends that fails, a question to its user, numbers among its options."""

import argparse
import math
import sys

from cspace.errors import ConfigError, CspaceError


def report_error(error: CspaceError, *wrong: type[CspaceError], program: str = "error") -> int:
    """Print an error; returns the exit code, 2 for a wrong request and 1 for whatever else failed.

    Args:
        error: that ended the command.
        wrong: the kinds of error that a wrong request ends with.
        program: what the line begins with.
    """
    sys.stderr.write(f"{program}: {error}\n")
    return 2 if isinstance(error, wrong) else 1


def confirmed(question: str) -> bool:
    """Whether the person at the terminal says yes.

    Raises:
        ConfigError: there is no terminal.
    """
    if not sys.stdin.isatty():
        raise ConfigError("there is nobody to ask", expected="a terminal", remedy="confirm with --yes")
    return input(f"{question} [y/N] ").strip().lower() in {"y", "yes"}


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
