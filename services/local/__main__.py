"""``python -m services.local``: the services of this machine, and the main job on them."""

import argparse
import os
import shlex
import sys
import webbrowser
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path

from cspace.errors import ConfigError, CspaceError, PortTakenError, ServiceError
from services.commands import aligned, confirmed, settings_of
from services.local.quickstart import TOURS, addresses, import_arm, quickstart, serve_untrained, tour_of_arm
from services.local.stack import (
    BIN,
    HOST,
    SERVICES,
    Settings,
    down,
    drop_state,
    leftovers,
    shell_values,
    size_text,
    state_parts,
    status,
    up,
    viewer_page,
)

# Of a desktop, or what somebody set for the purpose; browsers of a terminal would take it over.
SCREENS = ("DISPLAY", "WAYLAND_DISPLAY", "BROWSER")
_say = partial(print, flush=True)
EXIT_CODES = "Exit codes: 0 done, 1 failed, 2 wrong usage or setting, 3 port taken, 4 not all healthy."
DESCRIPTION = """MLflow, a Ray head and the inference API on loopback, under supervisord.
docs/operations.md lists the settings."""


def main(arguments: Sequence[str] | None = None) -> int:
    """Parse, run one command, print; returns the exit code."""
    options = make_parser().parse_args(arguments)
    # Loopback is behind no proxy, and Ray's clients take the token from where Ray keeps it.
    for name in ("NO_PROXY", "no_proxy"):
        os.environ[name] = ",".join(filter(None, [os.environ.get(name), HOST, "localhost"]))
    os.environ["RAY_AUTH_MODE"] = "token"
    try:
        return options.run(settings_of(Settings), options) or 0
    except (CspaceError, OSError) as error:
        sys.stderr.write(f"error: {error}\n")
        codes: dict[type[Exception], int] = {ConfigError: 2, PortTakenError: 3}
        return codes.get(type(error), 1)
    except KeyboardInterrupt:
        sys.stderr.write("\ninterrupted; what was started goes on: `make status`, `make down`\n")
        return 130


def _up(settings: Settings, _: argparse.Namespace) -> None:
    up(settings, SERVICES, _say)
    _say(f"\n{addresses(settings)}")


def _down(settings: Settings, _: argparse.Namespace) -> None:
    if not down(settings, _say):
        _say("nothing was running")


def _status(settings: Settings, _: argparse.Namespace) -> int:
    table, healthy = status(settings)
    _say(f"{table}\nstate folder {settings.home}, {size_text(settings.home)}")
    return 0 if healthy else 4


def _env(settings: Settings, _: argparse.Namespace) -> None:
    for name, value in shell_values(settings).items():
        _say(f"export {name}={shlex.quote(value)}")
    _say(f'export PATH={shlex.quote(str(BIN))}:"$PATH"')


def _clean_state(settings: Settings, options: argparse.Namespace) -> int:
    if leftovers(settings):
        raise ServiceError("services still run", remedy="`make down` first")
    parts = state_parts(settings)
    if not parts:
        _say(f"there is nothing in {settings.home}")
        return 0
    _say(aligned([(str(part), size_text(part)) for part in parts]))
    if not options.yes and not confirmed("delete all of this: runs, models and data?"):
        _say("nothing was deleted")
        return 1
    drop_state(settings)
    _say(f"deleted {settings.home}")
    return 0


def _demo(settings: Settings, options: argparse.Namespace) -> None:
    # The viewer asks the API for the model's arm.
    up(settings, ("api",), _say)
    up(settings, ("viewer",), _say)
    page = viewer_page(settings)
    _say(f"\nseven joints, in 3D   {page}\nplanar arm, in 2D     {settings.url('api')}/")
    _say("`make down` ends both.")
    if not options.no_browser and any(os.environ.get(name) for name in SCREENS):
        webbrowser.open(page)


def _quickstart(settings: Settings, options: argparse.Namespace) -> None:
    quickstart(settings, TOURS[options.world], _say)


def _arm(settings: Settings, options: argparse.Namespace) -> None:
    file = import_arm(settings, options.urdf, options.import_options, _say)
    if options.untrained:
        serve_untrained(settings, file, _say)
    else:
        quickstart(settings, tour_of_arm(file), _say)
    _say(f"The robot is in {file}; `python -m services.planner --robot {file} --whole-plan` plans with it.")


def make_parser() -> argparse.ArgumentParser:
    """The parser of all commands; ``run`` of its options takes the settings and these options."""
    parser = argparse.ArgumentParser(
        prog="python -m services.local", description=DESCRIPTION, epilog=EXIT_CODES
    )
    commands = parser.add_subparsers(required=True, metavar="command")

    def add(
        name: str, run: Callable[[Settings, argparse.Namespace], int | None], words: str
    ) -> argparse.ArgumentParser:
        command = commands.add_parser(name, help=words, description=words, epilog=EXIT_CODES)
        command.set_defaults(run=run)
        return command

    add("up", _up, "start what does not run, wait until it is healthy, print the addresses")
    add("down", _down, "end exactly what was started")
    add("status", _status, "show what supervisord runs, whether it answers, and the state folder")
    add("env", _env, 'print the lines that set a shell up for jobs: eval "$(... env)"')
    clean = add("clean-state", _clean_state, "delete the state folder: runs, models, data, logs")
    clean.add_argument("--yes", action="store_true", help="do not ask")
    demo = add("demo", _demo, "start the API on the shipped models and the 3D viewer, and open the viewer")
    demo.add_argument("--no-browser", action="store_true", help="print the address alone")
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
