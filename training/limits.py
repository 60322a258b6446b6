"""``python -m training.limits BUNDLE FOLDER --arm NAME``: a bundle with narrower joint limits of its robot.

Nothing is trained, and the graphs stay as they are, byte for byte: what they put outside the new limits is
rejected when the bundle samples. The golden case is computed again: its samples lie within the new limits.

Exit codes: 0 done, 1 the bundle or the disk is bad, 2 the command is wrong.
"""

import argparse
import sys
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from cspace.bundle import Bundle, graphs_of, load_verified, write_bundle
from cspace.errors import BundleError, CspaceError, InputError
from cspace.world import World
from cspace.worlds import add_world_options, described_world
from services.commands import report_error


def main(arguments: Sequence[str] | None = None) -> int:
    """Parse, write, print."""
    options = parser().parse_args(arguments)
    try:
        folder = write_limited(load_verified(options.bundle), options.folder, described_world(options))
    except CspaceError as error:
        return report_error(error, InputError)
    sys.stdout.write(f"written to {folder}\n")
    return 0


def parser() -> argparse.ArgumentParser:
    """The command line."""
    parser = argparse.ArgumentParser(
        prog="python -m training.limits",
        description="Give a bundle the narrower joint limits of another description of its robot.",
        epilog="Exit codes: 0 done, 1 failed, 2 bad input.",
    )
    parser.add_argument("bundle", type=Path, help="whose networks")
    parser.add_argument("folder", type=Path, help="where the new one goes; must not exist")
    add_world_options(parser, sensor=False)
    return parser


def write_limited(source: Bundle, folder: Path, world: World) -> Path:
    """Write a bundle's networks with the joint limits of another world's robot, which are no wider."""
    own, new = source.spec.world.space, world.space
    fits = own.dim == new.dim and own.periodic == new.periodic
    if not fits or not own.contains([new.lower, new.upper]).all():
        raise BundleError(
            "the limits do not fit the bundle",
            expected=f"{own.dim} joints, within {own.lower} to {own.upper} rad",
            got=f"{new.lower} to {new.upper} rad",
        )
    limited = source.within(world)
    note = {"trained_lower": own.lower, "trained_upper": own.upper, "source_digest": source.digest}
    source_provenance = limited.spec.provenance
    provenance = replace(source_provenance, config={**source_provenance.config, "limits_narrowed": note})
    spec = replace(limited.spec, provenance=provenance)
    return write_bundle(folder, spec, graphs_of(source.folder))


if __name__ == "__main__":
    sys.exit(main())
