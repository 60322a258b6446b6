"""``python -m services.local``: the services of this machine, and the main job on them."""

import argparse
import os
import sys
from collections.abc import Sequence

from cspace.errors import ConfigError, CspaceError, PortTakenError
from services.local.commands import COMMANDS
from services.local.settings import Settings, without_proxy

EXIT_CODES = (
    "Exit codes: 0 done, 1 failed, 2 wrong usage or setting, 3 a port is taken, 4 services do not run."
)


def main(arguments: Sequence[str] | None = None) -> int:
    """Parse, run one command, print; returns the exit code."""
    options = _parser().parse_args(arguments)
    # Clients of the services honour proxies; loopback is behind none.
    os.environ.update(without_proxy(os.environ))
    try:
        return COMMANDS[options.command].run(Settings.from_environment(os.environ), options)
    except CspaceError as error:
        print(f"error: {error}", file=sys.stderr)
        return exit_code(error)
    except KeyboardInterrupt:
        print("\ninterrupted; what was started goes on: `make status`, `make down`", file=sys.stderr)
        return 130


def exit_code(error: CspaceError) -> int:
    """The documented exit code of an error."""
    if isinstance(error, ConfigError):
        return 2
    return 3 if isinstance(error, PortTakenError) else 1


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="python -m services.local",
        description="MLflow, a Ray head and the inference API on loopback. "
        "Settings: CSPACE_HOME (state folder), CSPACE_API_PORT, CSPACE_RAY_PORT, CSPACE_MLFLOW_PORT, "
        "CSPACE_VIEWER_PORT, CSPACE_RAY_CPUS.",
        epilog=EXIT_CODES,
    )
    parsers = parser.add_subparsers(dest="command", required=True, metavar="command")
    for name, command in COMMANDS.items():
        sub = parsers.add_parser(name, help=command.help, description=command.help, epilog=EXIT_CODES)
        command.options(sub)
    return parser


if __name__ == "__main__":
    sys.exit(main())
