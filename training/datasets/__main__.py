"""Data sets: ``python -m training.datasets generate|paths|import|verify``.

Exit codes: 0 done; 1 the data or the disk is bad; 2 the command is wrong.
"""

import argparse
import logging
import os
import sys
from collections.abc import Sequence
from pathlib import Path

from pydantic import ValidationError

from cspace.dataset import Dataset, open_dataset
from cspace.errors import ConfigError, CspaceError, ScenarioError
from cspace.splits import Split
from cspace.worlds.planar.arm import JointLimits, PlanarArm
from cspace.worlds.planar.camera import Camera
from cspace.worlds.planar.world import PlanarWorld
from training.datasets.config import DatasetConfig, PathDatasetConfig
from training.datasets.own import import_folder


def main(arguments: Sequence[str] | None = None) -> int:
    """Parse, call, print; returns the exit code."""
    options = parser().parse_args(arguments)
    logging.basicConfig(level=logging.WARNING, format="%(message)s")
    logging.getLogger("training").setLevel(logging.INFO)
    try:
        dataset = options.run(options)
    except (ConfigError, ScenarioError) as error:
        print(f"error: {error}", file=sys.stderr)
        return 2
    except CspaceError as error:
        print(f"error: {error}", file=sys.stderr)
        return 1
    print(describe(dataset))
    return 0


def describe(dataset: Dataset) -> str:
    """What a data set holds, in lines."""
    counts = "\n".join(f"  {name:<16}{count}" for name, count in sorted(dataset.manifest.counts.items()))
    return f"{dataset.folder}\n{counts}\n  joints          {dataset.dim}\n  digest          {dataset.digest}"


def parser() -> argparse.ArgumentParser:
    """The command line."""
    result = argparse.ArgumentParser(
        prog="python -m training.datasets",
        description="Make, import and verify data-set folders.",
        epilog="Exit codes: 0 done, 1 the data or the disk is bad, 2 the command is wrong.",
    )
    commands = result.add_subparsers(required=True, metavar="COMMAND")
    _add_generate(
        commands.add_parser("generate", help="random scenarios, by Ray tasks; goes on where it stopped")
    )
    _add_paths(commands.add_parser("paths", help="near-optimal paths between starts and goals, by Ray tasks"))
    _add_import(commands.add_parser("import", help="your own pictures (PNG) and configurations (.npy)"))
    verify = commands.add_parser("verify", help="check a folder's format and every file's digest")
    verify.add_argument("folder", type=Path)
    verify.set_defaults(run=lambda options: open_dataset(options.folder, verify=True))
    return result


def _add_generate(parser: argparse.ArgumentParser) -> None:
    fields = DatasetConfig.model_fields
    parser.add_argument("folder", type=Path, help="where the data set goes")
    parser.add_argument("--split", choices=[str(split) for split in Split], default=fields["split"].default)
    for name in ("seed", "scenario_count", "free_per_scenario", "collision_per_scenario"):
        parser.add_argument(f"--{name.replace('_', '-')}", type=int, default=fields[name].default)
    parser.add_argument("--extra-image-count", type=int, default=fields["extra_image_count"].default)
    parser.add_argument("--shard-size", type=int, default=fields["shard_size"].default)
    _add_robot(parser)
    parser.set_defaults(run=lambda options: _made(options, DatasetConfig))


def _add_paths(parser: argparse.ArgumentParser) -> None:
    fields = PathDatasetConfig.model_fields
    parser.add_argument("folder", type=Path, help="where the data set goes")
    parser.add_argument("--split", choices=[str(split) for split in Split], default=fields["split"].default)
    kinds = {
        int: (
            "seed",
            "scenario_count",
            "pairs_per_scenario",
            "points_per_path",
            "free_per_scenario",
            "shard_size",
        ),
        float: ("narrow_share", "time_limit_s"),
    }
    for kind, names in kinds.items():
        for name in names:
            described = fields[name].description
            parser.add_argument(
                f"--{name.replace('_', '-')}", type=kind, default=fields[name].default, help=described
            )
    parser.add_argument("--source", choices=("grid", "rrt_star"), default=fields["source"].default)
    _add_robot(parser)
    parser.set_defaults(run=lambda options: _made(options, PathDatasetConfig))


def _add_import(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "source", type=Path, help="name.png, name.npy, optional name.collision.npy, extra/*.png"
    )
    parser.add_argument("folder", type=Path, help="where the data set goes")
    parser.add_argument("--pixels", type=int, default=Camera().pixels, help="side of the data set's pictures")
    parser.add_argument(
        "--view",
        type=float,
        nargs=4,
        metavar=("XMIN", "XMAX", "YMIN", "YMAX"),
        default=(-5.0, 5.0, -5.0, 5.0),
    )
    _add_robot(parser)
    parser.set_defaults(run=_import)


def _add_robot(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--links", type=float, nargs="+", metavar="M", default=[2.0, 2.0], help="link lengths, m"
    )
    parser.add_argument("--half-width", type=float, metavar="M", default=0.1, help="half the links' width, m")
    parser.add_argument(
        "--limit",
        nargs=3,
        action="append",
        type=float,
        metavar=("JOINT", "LOW", "HIGH"),
        help="limits of one joint (1 is the first), rad; repeatable; other joints are circles",
    )


def _robot(options: argparse.Namespace) -> PlanarArm:
    return PlanarArm(tuple(options.links), options.half_width, _limits(options.limit, len(options.links)))


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


def _made(options: argparse.Namespace, kind: type[DatasetConfig] | type[PathDatasetConfig]) -> Dataset:
    robot = _robot(options)
    values = {name: getattr(options, name) for name in kind.model_fields if name != "robot"}
    described = {key: value for key, value in robot.to_dict().items() if key != "kind"}
    try:
        config = kind.model_validate({**values, "robot": described})
    except ValidationError as error:
        first = error.errors()[0]
        raise ConfigError(
            f"{first['loc'][0]} does not fit", expected=first["msg"], got=repr(first["input"])
        ) from error
    # A Ray that this command starts for itself reports no use; its token mode is that of all the services.
    os.environ.setdefault("RAY_USAGE_STATS_ENABLED", "0")
    os.environ.setdefault("RAY_AUTH_MODE", "token")
    # Imported here so that import and verify do not wait for Ray.
    import ray  # noqa: PLC0415

    from training.datasets.generate import generate  # noqa: PLC0415

    if not ray.is_initialized():
        ray.init(log_to_driver=False, logging_level=logging.WARNING, include_dashboard=False)
    return generate(config, options.folder.absolute())


def _import(options: argparse.Namespace) -> Dataset:
    x_min_m, x_max_m, y_min_m, y_max_m = options.view
    if options.pixels < 1 or not (x_min_m < x_max_m and y_min_m < y_max_m):
        raise ConfigError(
            "the camera does not fit",
            expected="--pixels above 0, --view with minimum below maximum",
            got=f"{options.pixels} pixels, {options.view}",
        )
    camera = Camera(x_min_m, x_max_m, y_min_m, y_max_m, options.pixels)
    return import_folder(options.source, options.folder, world=PlanarWorld(_robot(options), camera))


if __name__ == "__main__":
    sys.exit(main())
