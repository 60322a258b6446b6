"""``python -m services.local``: the services of this machine, and the main job on them."""

import argparse
import os
import sys
import webbrowser
from collections.abc import Callable, Sequence
from pathlib import Path

from cspace.errors import ConfigError, CspaceError, PortTakenError, ServiceError
from services.command_errors import confirmed
from services.evaluator.tables import aligned
from services.local.own_arm import import_arm, serve_untrained, tour_of_arm
from services.local.quickstart import TOURS, quickstart
from services.local.settings import Settings, read_settings, shell_lines, without_proxy
from services.local.stack import SERVICES, addresses, down, leftovers, status, up, viewer_page
from services.local.state import drop_state, size_bytes, state_parts

# Of a desktop, or what somebody set for the purpose; browsers of a terminal would take it over.
SCREENS = ("DISPLAY", "WAYLAND_DISPLAY", "BROWSER")
NOT_HEALTHY = 4
EXIT_CODES = "Exit codes: 0 done, 1 failed, 2 wrong usage or setting, 3 a port is taken, 4 not all is healthy."


def main(arguments: Sequence[str] | None = None) -> int:
    """Parse, run one command, print; returns the exit code."""
    options = make_parser().parse_args(arguments)
    # Loopback is behind no proxy, and Ray's clients take the token from where Ray keeps it.
    os.environ.update(without_proxy(os.environ) | {"RAY_AUTH_MODE": "token"})
    try:
        code: int = options.run(read_settings(), options)
    except CspaceError as error:
        sys.stderr.write(f"error: {error}\n")
        return {ConfigError: 2, PortTakenError: 3}.get(type(error), 1)
    except KeyboardInterrupt:
        sys.stderr.write("\ninterrupted; what was started goes on: `make status`, `make down`\n")
        return 130
    return code


def _say(line: str) -> None:
    sys.stdout.write(f"{line}\n")
    sys.stdout.flush()


def _up(settings: Settings, _: argparse.Namespace) -> int:
    up(settings, SERVICES, _say)
    _say(f"\n{addresses(settings)}")
    return 0


def _down(settings: Settings, _: argparse.Namespace) -> int:
    if not down(settings, _say):
        _say("nothing was running")
    return 0


def _status(settings: Settings, _: argparse.Namespace) -> int:
    found = status(settings)
    rows = [("service", "state", "", "health", "address")]
    for one in found:
        health = "healthy" if one.healthy else "not healthy"
        rows.append((one.name, one.state, one.description, health, one.url))
    _say(f"{aligned(rows)}\nstate folder {settings.home}, {size_bytes(settings.home) / 1e6:.0f} MB")
    return 0 if all(one.healthy for one in found) else NOT_HEALTHY


def _env(settings: Settings, _: argparse.Namespace) -> int:
    _say("\n".join(shell_lines(settings)))
    return 0


def _clean_state(settings: Settings, options: argparse.Namespace) -> int:
    if leftovers(settings):
        raise ServiceError("services still run", remedy="`make down` first")
    parts = state_parts(settings)
    if not options.yes:
        _say(aligned([(str(part), f"{size / 1e6:.0f} MB") for part, size in parts.items()]) if parts else "")
        if not confirmed(f"delete all of this in {settings.home}: runs, models and data?"):
            _say("nothing was deleted")
            return 1
    drop_state(settings)
    _say(f"deleted {settings.home} ({sum(parts.values()) / 1e6:.0f} MB)")
    return 0


def _demo(settings: Settings, options: argparse.Namespace) -> int:
    """Start the API and the viewer, print the address that the viewer reports, and open it."""
    # The viewer asks the API for the model's arm.
    up(settings, ("api",), _say)
    up(settings, ("viewer",), _say)
    page = viewer_page(settings)
    _say(
        f"\nseven joints, in 3D   {page}\nplanar arm, in 2D     {settings.api_url}/\n\n`make down` ends both."
    )
    if not options.no_browser and any(os.environ.get(name) for name in SCREENS):
        webbrowser.open(page)
    return 0


def _quickstart(settings: Settings, options: argparse.Namespace) -> int:
    quickstart(settings, TOURS[options.world], _say)
    return 0


def _arm(settings: Settings, options: argparse.Namespace) -> int:
    file = import_arm(settings, options.urdf, options.import_options, _say)
    if options.untrained:
        serve_untrained(settings, file, _say)
    else:
        quickstart(settings, tour_of_arm(file), _say)
    _say(f"The robot is in {file}; `python -m services.planner --robot {file} --whole-plan` plans with it.")
    return 0


def make_parser() -> argparse.ArgumentParser:
    """The parser of all commands; ``run`` of its options takes the settings and these options."""
    parser = argparse.ArgumentParser(
        prog="python -m services.local",
        description="MLflow, a Ray head and the inference API on loopback, under supervisord. "
        "Settings: CSPACE_HOME (state folder), CSPACE_API_PORT, CSPACE_RAY_PORT, CSPACE_MLFLOW_PORT, "
        "CSPACE_VIEWER_PORT, CSPACE_RAY_CPUS.",
        epilog=EXIT_CODES,
    )
    commands = parser.add_subparsers(required=True, metavar="command")

    def add(
        name: str, run: Callable[[Settings, argparse.Namespace], int], words: str
    ) -> argparse.ArgumentParser:
        command = commands.add_parser(name, help=words, description=words, epilog=EXIT_CODES)
        command.set_defaults(run=run)
        return command

    add("up", _up, "start what does not run, wait until it is healthy, print the addresses")
    add("down", _down, "end exactly what was started")
    add("status", _status, "show what supervisord runs, whether it answers, and the state folder")
    add("env", _env, 'print the lines that set a shell up for jobs: eval "$(... env)"')
    add("clean-state", _clean_state, "delete the state folder: runs, models, data, logs").add_argument(
        "--yes", action="store_true", help="do not ask"
    )
    add(
        "demo", _demo, "start the API on the shipped models and the 3D viewer, and open the viewer"
    ).add_argument("--no-browser", action="store_true", help="print the address alone")
    main_job = add("quickstart", _quickstart, "the main job: up, train, evaluate, promote, serve, plan")
    main_job.add_argument("--world", choices=sorted(TOURS), default="planar", help="default: %(default)s")
    arm = add("arm", _arm, "your own arm, from its URDF or xacro file to a served model")
    arm.add_argument("--untrained", action="store_true", help="serve it by the scene model, without training")
    arm.add_argument("urdf", type=Path, help="the description; a name that ends with .xacro is expanded")
    arm.add_argument(
        "import_options",
        nargs=argparse.REMAINDER,
        metavar="OPTION",
        help="of python -m training.robots import, such as --tip LINK --name NAME --ready A,B,...",
    )
    return parser


if __name__ == "__main__":
    sys.exit(main())
