"""Robots from descriptions: ``python -m training.robots import URDF --out FILE``.

Exit codes: 0 done; 1 the disk is bad; 2 the command or the description is wrong.
"""

import argparse
import json
import re
import sys
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import Any

from cspace import bounded_worker
from cspace.errors import ConfigError, CspaceError, ScenarioError
from cspace.files import replacing
from services.commands import finite, report_error
from training.robots.chain import Limits
from training.robots.importing import import_robot
from training.robots.spheres import Allowances

# An import takes minutes for a large arm.
IMPORT = bounded_worker.Limits(memory_bytes=2**30, cpu_s=1200, wall_s=1800.0, file_bytes=2**26)


def main(arguments: Sequence[str] | None = None) -> int:
    """Parse, call in a worker that the kernel bounds, print; returns the exit code."""
    given = sys.argv[1:] if arguments is None else list(arguments)
    options = parser().parse_args(given)
    try:
        lines: list[str] = bounded_worker.call(
            run,
            given,
            limits=IMPORT,
            what=str(options.urdf),
            error=ScenarioError,
            remedy="leave out meshes or links that the arm does not need, or simplify the meshes",
        )
    except CspaceError as error:
        return report_error(error, ConfigError, ScenarioError)
    print("\n".join(lines))
    return 0


def run(arguments: Sequence[str]) -> list[str]:
    """Import and write; what is to be said of the robot, in lines."""
    options = parser().parse_args(arguments)
    if options.name is not None and re.fullmatch("[a-z0-9]([a-z0-9-]{0,38}[a-z0-9])?", options.name) is None:
        fitting = "1 to 40 lower-case letters, digits and dashes, no dash at an end"
        raise ConfigError("--name does not fit", expected=fitting, got=repr(options.name)[:200])
    excess_m = (10.0 if options.excess_mm is None else options.excess_mm) / 1e3
    imported = import_robot(
        options.urdf,
        name=options.name,
        srdf=options.srdf,
        tip=options.tip,
        locked=dict(options.lock),
        limits=dict(options.limit),
        packages=dict(options.package),
        arguments=dict(options.xacro),
        without=options.without,
        kept=options.keep,
        allowances=Allowances(options.slack_mm / 1e3, excess_m, relaxed=options.excess_mm is None),
        ready_rad=options.ready,
        report=lambda name: print(f"covering {name}", flush=True),
    )
    text = json.dumps(imported.arm.to_dict(), indent=1, allow_nan=False)
    # A list of numbers in one line each.
    text = re.sub(r"\[\s*([^\[\]{}]*?)\s*\]", lambda found: f"[{' '.join(found[1].split())}]", text)
    with replacing(options.out, "the robot") as beside:
        beside.write_text(text + "\n", encoding="utf-8")
    return [*imported.lines(), f"written to {options.out}"]


def parser() -> argparse.ArgumentParser:
    """The command line."""
    result = argparse.ArgumentParser(
        prog="python -m training.robots",
        description="Make robots of the spatial world from descriptions.",
        epilog="Exit codes: 0 done, 1 the disk is bad, 2 the command or the description is wrong.",
    )
    commands = result.add_subparsers(required=True, metavar="COMMAND")
    one = commands.add_parser("import", help="a serial arm from a URDF or xacro file")
    one.add_argument("urdf", type=Path, help="the description; a name that ends with .xacro is expanded")
    named = "of the robot and its models, as in NAME-sampler; default: the description's"
    one.add_argument("--name", help=named)
    one.add_argument("--srdf", type=Path, help="with the pairs that need no check; default: beside the URDF")
    tip = "whose frame is the tool's; default: the last link before a gripper or the first branch"
    one.add_argument("--tip", metavar="LINK", help=tip)
    held = "a joint that does not move, rad or m; those beside the chain are held at 0"
    for name, value, kind, help_text in (
        ("--lock", "JOINT=VALUE", finite, held),
        ("--limit", "JOINT=LOW,HIGH", _limits, "instead of the description's, rad; JOINT=none for a circle"),
        ("--package", "NAME=FOLDER", Path, "where a package of meshes or xacro files lies"),
        ("--xacro", "NAME=VALUE", str, "an argument of xacro"),
    ):
        one.add_argument(
            name, action="append", default=[], type=partial(_pair, kind), metavar=value, help=help_text
        )
    without = "leave out the shapes of a link and of all behind it"
    one.add_argument("--without", action="append", default=[], metavar="LINK", help=without)
    keep_help = "a pair that is held apart whatever the SRDF says"
    one.add_argument("--keep", action="append", default=[], nargs=2, metavar="LINK", help=keep_help)
    waits = "where the arm waits, rad; default: the middle of its limits"
    one.add_argument("--ready", type=_numbers, metavar="A,B,...", help=waits)
    outside = "of the surface outside the spheres; default 2"
    one.add_argument("--slack-mm", type=float, default=2.0, help=outside)
    sticks_out = "that spheres stick out; default 10, and more of parts that are longer than 0.8 m"
    one.add_argument("--excess-mm", type=float, help=sticks_out)
    one.add_argument("--out", type=Path, required=True, metavar="FILE", help="where the robot goes, JSON")
    return result


def _pair(kind: Callable[[str], Any], text: str) -> tuple[str, Any]:
    name, _, value = text.partition("=")
    if not (name and value):
        raise argparse.ArgumentTypeError(f"expected NAME=VALUE, got {text[:80]!r}")
    return name, kind(value)


def _limits(text: str) -> Limits:
    low, _, high = text.partition(",")
    return None if text == "none" else (finite(low), finite(high))


def _numbers(text: str) -> tuple[float, ...]:
    return tuple(map(finite, text.split(",")))


if __name__ == "__main__":
    sys.exit(main())
