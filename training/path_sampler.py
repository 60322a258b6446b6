"""``python -m training.path_sampler BUNDLE FOLDER``: a path sampler of a bundle's validity head.

Nothing is trained: paths are searched for when samples are requested, the head chooses among them, and
samples are drawn along them. The command writes a bundle of the kind ``path``, which the inference API
serves like any other; with ``--register`` it becomes a version of ``path-sampler``, or of
``<robot>-path-sampler`` for a robot other than the default one.

A folder that holds this very path sampler already is taken as it is, so that the command may be given again.

Exit codes: 0 done, 1 the bundle, the disk or the registry is bad, 2 the command is wrong.
"""

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

from cspace.bundle.verification import load_verified
from cspace.errors import CspaceError, InputError
from services.commands import report_error
from services.names import model_name, recorded_name
from services.registry import tracking_uri
from training.jobs.job import ALIASES, register_untrained
from training.paths.writing import made_or_found


def main(arguments: Sequence[str] | None = None) -> int:
    """Parse, make, print."""
    options = parser().parse_args(arguments)
    try:
        uri = None if options.register is None else tracking_uri()
        source = load_verified(options.bundle)
        named = options.robot_name or recorded_name(source.spec.provenance.config)
        model = model_name(source.spec.world, named, path=True)
        bundle = made_or_found(source, options.folder)
        print(f"{bundle.folder}\n  digest {bundle.digest}")
        if uri is not None:
            print(
                f"  registered as {register_untrained(bundle, uri, model, options.register, 'path-sampler')}"
            )
    except CspaceError as error:
        return report_error(error, InputError)
    return 0


def parser() -> argparse.ArgumentParser:
    """The command line."""
    parser = argparse.ArgumentParser(
        prog="python -m training.path_sampler",
        description="Make a path sampler of a bundle's validity head; nothing is trained.",
        epilog="Reads MLFLOW_TRACKING_URI with --register. Exit codes: 0 done, 1 failed, 2 bad input.",
    )
    parser.add_argument("bundle", type=Path, help="a bundle with a validity head")
    parser.add_argument("folder", type=Path, help="where the path sampler goes")
    parser.add_argument(
        "--register",
        choices=ALIASES,
        help="make it a version of the robot's model of paths with this alias",
    )
    parser.add_argument("--robot-name", help="as of training jobs (default: the one in the bundle)")
    return parser


if __name__ == "__main__":
    sys.exit(main())
