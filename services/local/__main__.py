"""``python -m services.local``: the services of this machine, and the main job on them."""

import os
import sys
from collections.abc import Sequence

from cspace.errors import ConfigError, CspaceError, PortTakenError
from services.local.commands import make_parser
from services.local.settings import Settings, without_proxy


def main(arguments: Sequence[str] | None = None) -> int:
    """Parse, run one command, print; returns the exit code."""
    options = make_parser().parse_args(arguments)
    # Clients of the services honour proxies; loopback is behind none.
    os.environ.update(without_proxy(os.environ))
    try:
        code: int = options.run(Settings.from_environment(os.environ), options)
    except CspaceError as error:
        print(f"error: {error}", file=sys.stderr)
        return exit_code(error)
    except KeyboardInterrupt:
        print("\ninterrupted; what was started goes on: `make status`, `make down`", file=sys.stderr)
        return 130
    return code


def exit_code(error: CspaceError) -> int:
    """The documented exit code of an error."""
    if isinstance(error, ConfigError):
        return 2
    return 3 if isinstance(error, PortTakenError) else 1


if __name__ == "__main__":
    sys.exit(main())
