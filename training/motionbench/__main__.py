"""The benchmark's problems: ``python -m training.motionbench fetch --out FOLDER``.

``robot --out FILE`` writes its Panda, whose joint limits are wider than the maker's, for data of one's own.

Exit codes: 0 done; 1 the archive cannot be fetched or the disk is bad; 2 the command or the archive is wrong.
"""

import argparse
import json
import sys
from collections import Counter
from collections.abc import Sequence
from contextlib import nullcontext
from pathlib import Path

from cspace.errors import CspaceError, InputError
from cspace.files import replacing
from cspace.worlds.spatial.benchmark import LIMITS_RAD, write_problems
from cspace.worlds.spatial.world import shipped
from services.commands import report_error
from training.motionbench.archive import JOINTS, SHA256, read_archive, unpack_description
from training.motionbench.download import downloaded


def main(arguments: Sequence[str] | None = None) -> int:
    """Parse, call, print; returns the exit code."""
    options = parser().parse_args(arguments)
    try:
        if options.command == "robot":
            with replacing(options.out, "the robot") as beside:
                beside.write_text(json.dumps(shipped("panda").with_limits(LIMITS_RAD).to_dict()), "utf-8")
            return 0
        with downloaded(SHA256) if options.archive is None else nullcontext(options.archive) as archive:
            splits = read_archive(archive, SHA256, options.robot)
            if options.robot != "panda":
                print(unpack_description(archive, options.robot, options.out / "description"))
        for split, found in splits.items():
            path = write_problems(options.out, split, found)
            counts = Counter(one.family for one in found)
            print(f"{path}: {', '.join(f'{name} {count}' for name, count in counts.items())}")
    except CspaceError as error:
        return report_error(error, InputError)
    return 0


def parser() -> argparse.ArgumentParser:
    """The command line."""
    result = argparse.ArgumentParser(
        prog="python -m training.motionbench",
        description="Get MotionBenchMaker's problems.",
        epilog="Exit codes: 0 done, 1 the archive cannot be fetched or the disk is bad, 2 the command or the "
        "archive is wrong.",
    )
    commands = result.add_subparsers(dest="command", required=True, metavar="COMMAND")
    fetch = commands.add_parser("fetch", help="from the source archive of the package vamp-planner, by pip")
    fetch.add_argument("--archive", type=Path, help="the archive, where it was fetched already")
    fetch.add_argument(
        "--robot",
        choices=list(JOINTS),
        default="panda",
        help="whose problems; of others than the Panda the description comes, too (default: %(default)s)",
    )
    fetch.add_argument("--out", type=Path, required=True, metavar="FOLDER", help="where the problems go")
    robot = commands.add_parser("robot", help="the shipped Panda with the benchmark's joint limits")
    robot.add_argument("--out", type=Path, required=True, metavar="FILE", help="where the robot goes, JSON")
    return result


if __name__ == "__main__":
    sys.exit(main())
