"""The spatial world on a command line: an arm by its name or file."""

import argparse
from pathlib import Path

from cspace.errors import ConfigError
from cspace.files import read_bounded
from cspace.strict_json import parse_json
from cspace.worlds.spatial.robot.arm import SerialArm
from cspace.worlds.spatial.world import SpatialWorld, shipped, usual

_MAX_BYTES = 2**20


def add_options(parser: argparse.ArgumentParser, *, sensor: bool) -> None:
    """See :func:`cspace.worlds.add_world_options`."""
    del sensor
    parser.add_argument(
        "--arm",
        metavar="NAME|FILE",
        help="a serial arm in space, seen by depth cameras: panda, or what python -m training.robots wrote",
    )


def described(options: argparse.Namespace) -> SpatialWorld | None:
    """The spatial world of parsed options; None where they name no such arm.

    Raises:
        ConfigError: the file cannot be read.
        ScenarioError: there is no such arm, or it cannot be.
    """
    if options.arm is None:
        return None
    path = Path(options.arm)
    if not path.is_file():
        return usual(shipped(options.arm))
    data = read_bounded(path, _MAX_BYTES, ConfigError)
    try:
        values = parse_json(data)
    except ValueError as error:
        raise ConfigError(
            f"{path} holds no robot", expected="JSON of an arm", got=str(error)[:200]
        ) from error
    return usual(SerialArm.from_dict(values))
