"""The commands of ``python -m services.local``, each with its options, texts and exit code."""

import argparse
import os
import sys
import webbrowser
from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path

from services.command_errors import confirmed
from services.evaluator.tables import aligned
from services.local.own_arm import import_arm, serve_untrained, tour_of_arm
from services.local.quickstart import TOURS, USUAL, quickstart
from services.local.settings import Settings, drop_state, shell_lines, size_text, state_parts
from services.local.stack import (
    addresses,
    api_server,
    down,
    require_down,
    services,
    shell_help,
    started_here,
    status,
    status_table,
    up,
    viewer,
)

# Of a desktop, or what somebody set for the purpose; browsers of a terminal would take it over.
_SCREENS = ("DISPLAY", "WAYLAND_DISPLAY", "BROWSER")


def demo(
    settings: Settings,
    say: Callable[[str], None],
    *,
    browser: bool,
    environment: Mapping[str, str] = os.environ,
    open_page: Callable[[str], object] = webbrowser.open,
) -> None:
    """Start the API and the 3D viewer where they do not run, print their addresses, and open the viewer.

    Args:
        settings: of the services.
        say: takes lines for people.
        browser: whether a browser is wanted.
        environment: that tells whether there is a screen.
        open_page: opens an address.

    Raises:
        PortTakenError: a stranger listens on one of the ports.
        ServiceError: the API belongs to another checkout.
        ServiceStartError: it did not come up.
    """
    up(settings, (api_server(settings),), say)
    # The viewer asks the API for the model's arm.
    up(settings, (viewer(settings),), say)
    page = f"{settings.viewer_url}/"
    say(
        f"\nseven joints, in 3D        {page}\nplanar arm, in 2D          {settings.api_url}/\n\n"
        "Both stay up; `make down` ends them."
    )
    if browser and any(environment.get(name) for name in _SCREENS):
        open_page(page)


NOT_RUNNING = 4


EXIT_CODES = (
    "Exit codes: 0 done, 1 failed, 2 wrong usage or setting, 3 a port is taken, 4 services do not run."
)


def _say(line: str) -> None:
    sys.stdout.write(f"{line}\n")
    sys.stdout.flush()


def _up(settings: Settings, _: argparse.Namespace) -> int:
    up(settings, services(settings), _say)
    _say(f"\n{addresses(settings)}\n\n{shell_help(settings)}")
    return 0


def _down(settings: Settings, _: argparse.Namespace) -> int:
    if not down(settings, started_here(settings), _say):
        _say("nothing was running")
    return 0


def _status(settings: Settings, _: argparse.Namespace) -> int:
    statuses = status(settings, started_here(settings))
    _say(status_table(settings, statuses))
    return 0 if all(one.healthy for one in statuses) else NOT_RUNNING


def _env(settings: Settings, _: argparse.Namespace) -> int:
    _say("\n".join(shell_lines(settings)))
    return 0


def _clean_state(settings: Settings, options: argparse.Namespace) -> int:
    require_down(settings, started_here(settings))
    if not settings.home.is_dir():
        _say(f"there is no {settings.home}")
        return 0
    parts = state_parts(settings)
    rows = [(str(part), size_text(size)) for part, size in parts.items()]
    if not options.yes:
        _say(aligned(rows))
        if not confirmed("delete all of this: runs, models and data?"):
            _say("nothing was deleted")
            return 1
    drop_state(settings)
    _say(f"deleted {settings.home} ({size_text(sum(parts.values()))})")
    if settings.home.is_dir():
        left = ", ".join(sorted(path.name for path in settings.home.iterdir()))
        _say(f"left what is not this project's: {left}")
    return 0


def _quickstart(settings: Settings, options: argparse.Namespace) -> int:
    tour = TOURS[options.world]
    train, evaluate = options.train or tour.train, options.evaluate or tour.evaluate
    quickstart(settings, replace(tour, train=train, evaluate=evaluate), _say)
    return 0


def _arm(settings: Settings, options: argparse.Namespace) -> int:
    file = import_arm(settings, options.urdf, options.import_options, _say)
    if options.untrained:
        serve_untrained(settings, file, _say)
    else:
        quickstart(settings, tour_of_arm(file), _say)
    _say(f"The robot is in {file}; `python -m services.planner --robot {file} --whole-plan` plans with it.")
    return 0


def _demo(settings: Settings, options: argparse.Namespace) -> int:
    demo(settings, _say, browser=not options.no_browser)
    return 0


def make_parser() -> argparse.ArgumentParser:
    """The parser of all commands; ``run`` of its options takes the settings and these options."""
    parser = argparse.ArgumentParser(
        prog="python -m services.local",
        description="MLflow, a Ray head and the inference API on loopback. "
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

    add("up", _up, "start what does not run, wait until it is ready, print the addresses")
    add("down", _down, "end exactly what was started, by process id")
    add("status", _status, "show what runs, since when, where, whether it answers; and the state folder")
    add(
        "demo", _demo, "start the API on the shipped models and the 3D viewer, and open the viewer"
    ).add_argument("--no-browser", action="store_true", help="print the address alone")
    main_job = add("quickstart", _quickstart, "the main job: up, train, evaluate, promote, serve, plan")
    main_job.add_argument(
        "--world", choices=sorted(TOURS), default=USUAL, help="whose job it is (default: %(default)s)"
    )
    main_job.add_argument(
        "--train",
        metavar="COMMAND",
        help=f"entry point of the training job (default: the world's; {TOURS[USUAL].train})",
    )
    main_job.add_argument(
        "--evaluate",
        metavar="COMMAND",
        help="entry point of the evaluation job; {model} is the new version "
        f"(default: the world's; {TOURS[USUAL].evaluate})",
    )
    arm = add("arm", _arm, "your own arm, from its URDF or xacro file to a served model")
    arm.add_argument(
        "--untrained", action="store_true", help="serve it by the scene model alone, without training"
    )
    arm.add_argument("urdf", type=Path, help="the description; a name that ends with .xacro is expanded")
    arm.add_argument(
        "import_options",
        nargs=argparse.REMAINDER,
        metavar="OPTION",
        help="of python -m training.robots import, such as --tip LINK --name NAME --ready A,B,...",
    )
    add("clean-state", _clean_state, "delete the state folder: runs, models, data, logs").add_argument(
        "--yes", action="store_true", help="do not ask"
    )
    add("env", _env, 'print the lines that set a shell up for jobs: eval "$(... env)"')
    return parser
