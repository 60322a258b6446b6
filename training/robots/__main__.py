"""Robots from descriptions: ``python -m training.robots import URDF --out FILE``.

Exit codes: 0 done; 1 the disk is bad; 2 the command or the description is wrong.
"""

import argparse
import math
import sys
from collections.abc import Sequence
from pathlib import Path

from cspace.errors import ConfigError, CspaceError, ScenarioError
from cspace.files import replacing
from services.command_errors import tell_error
from training.robots.covering import Allowances
from training.robots.importing import Imported, Request, import_robot, robot_text


def main(arguments: Sequence[str] | None = None) -> int:
    """Parse, call, print; returns the exit code."""
    options = parser().parse_args(arguments)
    try:
        imported = import_robot(_request(options), lambda name: print(f"covering {name}", flush=True))
        with replacing(options.out, "the robot") as beside:
            beside.write_text(robot_text(imported.arm), encoding="utf-8")
    except CspaceError as error:
        return tell_error(error, ConfigError, ScenarioError)
    print(described(imported))
    print(f"written to {options.out}")
    return 0


def described(imported: Imported) -> str:
    """How well the spheres fit, and which parts are held apart, in lines."""
    lines = [f"{'part':<24}spheres  missed mm  missed %  sticks out mm  mean mm"]
    for name, fit in imported.fits.items():
        lines.append(
            f"{name:<24}{fit.spheres:>7}{1e3 * fit.missed_m:>11.2f}{100.0 * fit.missed_share:>10.2f}"
            f"{1e3 * fit.excess_m:>15.2f}{1e3 * fit.mean_excess_m:>9.2f}"
        )
    arm = imported.arm
    lines.append(f"{arm.name}: {arm.dim} joints, {arm.sphere_count} spheres, {len(arm.touching)} pairs")
    lines += [
        f"  {one.pair[0]} and {one.pair[1]}: overlap in {100.0 * one.share:.2f} % of configurations"
        f"{'' if one.kept else ', not held apart'}"
        for one in imported.touching
        if one.share > 0.0 or one.kept
    ]
    return "\n".join(lines)


def parser() -> argparse.ArgumentParser:
    """The command line."""
    result = argparse.ArgumentParser(
        prog="python -m training.robots",
        description="Make robots of the spatial world from descriptions.",
        epilog="Exit codes: 0 done, 1 the disk is bad, 2 the command or the description is wrong.",
    )
    commands = result.add_subparsers(required=True, metavar="COMMAND")
    one = commands.add_parser("import", help="a serial arm from a URDF file; meshes need the extra spatial")
    one.add_argument("urdf", type=Path, help="the description")
    one.add_argument("--srdf", type=Path, help="with the pairs of links that need no check")
    one.add_argument("--tip", metavar="LINK", help="whose frame is the tool's; default: the last link")
    one.add_argument(
        "--lock",
        action="append",
        default=[],
        metavar="JOINT=VALUE",
        help="a joint that does not move, rad or m",
    )
    one.add_argument(
        "--limit",
        action="append",
        default=[],
        metavar="JOINT=LOW,HIGH",
        help="instead of the description's, rad",
    )
    one.add_argument(
        "--package", action="append", default=[], metavar="NAME=FOLDER", help="where a package of meshes lies"
    )
    one.add_argument(
        "--keep",
        action="append",
        default=[],
        nargs=2,
        metavar="LINK",
        help="a pair that is held apart whatever the SRDF says",
    )
    one.add_argument(
        "--ready", metavar="A,B,...", help="where the arm waits, rad; default: the middle of its limits"
    )
    one.add_argument(
        "--slack-mm", type=float, default=2.0, help="of the surface outside the spheres; default 2"
    )
    one.add_argument("--excess-mm", type=float, default=10.0, help="that spheres stick out; default 10")
    one.add_argument("--out", type=Path, required=True, metavar="FILE", help="where the robot goes, JSON")
    return result


def _request(options: argparse.Namespace) -> Request:
    locked = {name: _number("--lock", value) for name, value in _pairs("--lock", options.lock)}
    limits = {}
    for name, value in _pairs("--limit", options.limit):
        low, _, high = value.partition(",")
        limits[name] = (_number("--limit", low), _number("--limit", high))
    return Request(
        urdf=options.urdf,
        srdf=options.srdf,
        tip=options.tip,
        locked=locked,
        limits=limits,
        packages={name: Path(value) for name, value in _pairs("--package", options.package)},
        kept=tuple((first, second) for first, second in options.keep),
        ready_rad=None
        if options.ready is None
        else tuple(_number("--ready", text) for text in options.ready.split(",")),
        allowances=Allowances(options.slack_mm / 1e3, options.excess_mm / 1e3),
    )


def _pairs(option: str, given: Sequence[str]) -> list[tuple[str, str]]:
    pairs = []
    for text in given:
        name, sign, value = text.partition("=")
        if not (name and sign and value):
            raise ConfigError(f"{option} does not fit", expected="NAME=VALUE", got=repr(text)[:200])
        pairs.append((name, value))
    return pairs


def _number(option: str, text: str) -> float:
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise ConfigError(f"{option} does not fit", expected="a finite number", got=repr(text)[:200])
    return value


if __name__ == "__main__":
    sys.exit(main())
