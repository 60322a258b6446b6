"""How a command ends that fails: a line for people, an exit code for programs."""

import sys

from cspace.errors import CspaceError


def tell_error(error: CspaceError, *wrong: type[CspaceError], program: str = "error") -> int:
    """Print an error; returns the exit code, 2 for a wrong request and 1 for whatever else failed.

    Args:
        error: that ended the command.
        wrong: the kinds of error that a wrong request ends with.
        program: what the line begins with.
    """
    sys.stderr.write(f"{program}: {error}\n")
    return 2 if isinstance(error, wrong) else 1
