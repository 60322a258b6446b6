"""The planar world on a command line: an arm by its links, a camera by its view."""

import argparse
from collections.abc import Sequence

from cspace.errors import ConfigError
from cspace.worlds.planar.arm import JointLimits, PlanarArm
from cspace.worlds.planar.seeing.camera import Camera
from cspace.worlds.planar.world import PlanarWorld


def add_options(parser: argparse.ArgumentParser, *, sensor: bool) -> None:
    """See :func:`cspace.worlds.add_world_options`."""
    arm, camera = PlanarArm(), Camera()
    parser.set_defaults(pixels=camera.pixels, view=camera.extent_m)
    if sensor:
        parser.add_argument("--pixels", type=int, help="side of the data set's pictures")
        parser.add_argument("--view", type=float, nargs=4, metavar=("XMIN", "XMAX", "YMIN", "YMAX"))
    parser.add_argument(
        "--links", type=float, nargs="+", metavar="M", default=arm.link_lengths_m, help="link lengths, m"
    )
    parser.add_argument(
        "--half-width", type=float, metavar="M", default=arm.half_width_m, help="half the links' width, m"
    )
    parser.add_argument(
        "--limit",
        nargs=3,
        action="append",
        type=float,
        metavar=("JOINT", "LOW", "HIGH"),
        help="limits of one joint (1 is the first), rad; repeatable; other joints are circles",
    )


def described(options: argparse.Namespace) -> PlanarWorld:
    """The planar world of parsed options.

    Raises:
        ConfigError: a limit is of no joint, or the camera cannot be.
        ScenarioError: the arm cannot be.
    """
    x_min_m, x_max_m, y_min_m, y_max_m = options.view
    if options.pixels < 1 or not (x_min_m < x_max_m and y_min_m < y_max_m):
        raise ConfigError(
            "the camera does not fit",
            expected="--pixels above 0, --view with minimum below maximum",
            got=f"{options.pixels} pixels, {options.view}",
        )
    arm = PlanarArm(tuple(options.links), options.half_width, _limits(options.limit, len(options.links)))
    return PlanarWorld(arm, Camera(x_min_m, x_max_m, y_min_m, y_max_m, options.pixels))


def _limits(entries: Sequence[tuple[float, float, float]] | None, dim: int) -> JointLimits | None:
    if not entries:
        return None
    limits: list[tuple[float, float] | None] = [None] * dim
    for joint, low, high in entries:
        if joint not in range(1, dim + 1):
            raise ConfigError(
                "the joint limits do not fit", expected=f"joints 1 to {dim}", got=f"joint {joint:g}"
            )
        limits[int(joint) - 1] = (low, high)
    return tuple(limits)
