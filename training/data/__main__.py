"""Data sets: ``python -m training.data generate|import|import-recording|import-outcomes|verify``.

Exit codes: 0 done; 1 the data or the disk is bad; 2 the command is wrong; 3 most of a recording's views fail
the diagnosis.
"""

import argparse
import logging
import math
import os
import sys
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, get_args

from pydantic import ValidationError

from cspace import bounded_worker
from cspace.dataset import Dataset, open_dataset
from cspace.errors import ConfigError, CspaceError, DatasetError, ScenarioError
from cspace.files import project_error
from cspace.world import World
from cspace.worlds import default_world, named_world
from services.commands import report_error
from services.registry import tracking_uri
from services.scene_files import given_scenes, read_scene_file
from training.data.config import USUAL_OF_ARMS, DatasetConfig
from training.data.outcomes import import_outcomes
from training.data.own_data import import_folder
from training.data.recordings import Imported, add_recording_options

# Pictures of an import are arrays in memory, 1 MB each.
IMPORT = bounded_worker.Limits(memory_bytes=2**30, cpu_s=600, wall_s=600.0, file_bytes=2**31)
FOUND = 3
_PARTS = ("robot", "robot_name", "camera", "scenes")


def main(arguments: Sequence[str] | None = None) -> int:
    """Parse, call, print; returns the exit code."""
    given = sys.argv[1:] if arguments is None else list(arguments)
    options = parser().parse_args(given)
    try:
        text, code = _import_bounded(options, given) if options.is_foreign else run(given)
    except CspaceError as error:
        return report_error(error, ConfigError, ScenarioError)
    print(text)
    return code


def run(arguments: Sequence[str]) -> tuple[str, int]:
    """Do what a command says; what it made, in lines, and the exit code."""
    logging.basicConfig(level=logging.WARNING, format="%(message)s")
    logging.getLogger("training").setLevel(logging.INFO)
    options = parser().parse_args(arguments)
    made = options.run(options)
    is_wrong = isinstance(made, Imported) and 2 * made.wrong > made.diagnosed
    return describe(made) if isinstance(made, Dataset) else str(made), FOUND if is_wrong else 0


def _import_bounded(options: argparse.Namespace, arguments: Sequence[str]) -> tuple[str, int]:
    """The same for files of others, in a worker that the kernel bounds."""
    limit_s = getattr(options, "time_limit_s", IMPORT.wall_s)
    found: tuple[str, int] = bounded_worker.call(
        run,
        list(arguments),
        limits=replace(IMPORT, cpu_s=max(1, math.ceil(limit_s)), wall_s=limit_s),
        what=str(options.source),
        error=DatasetError,
        remedy="cut the recording or leave topics out (ros2 bag convert), or raise --time-limit",
    )
    return found


def describe(dataset: Dataset) -> str:
    """What a data set holds, in lines."""
    counts = "\n".join(f"  {name:<16}{count}" for name, count in sorted(dataset.manifest.counts.items()))
    joints = f"  joints          {dataset.world.dim}"
    return f"{dataset.folder}\n{counts}\n{joints}\n  digest          {dataset.digest}"


def parser() -> argparse.ArgumentParser:
    """The command line."""
    result = argparse.ArgumentParser(
        prog="python -m training.data",
        description="Make, import and verify data-set folders.",
        epilog="Exit codes: 0 done, 1 the data or the disk is bad, 2 the command is wrong, "
        "3 most of a recording's views fail the diagnosis.",
    )
    result.set_defaults(is_foreign=False)
    commands = result.add_subparsers(required=True, metavar="COMMAND")
    _add_generate(
        commands.add_parser("generate", help="random scenarios, by Ray tasks; goes on where it stopped")
    )
    _add_import(commands.add_parser("import", help="your own pictures (PNG) and configurations (.npy)"))
    add_recording_options(
        commands.add_parser(
            "import-recording", help="a recording of ROS 2 (.mcap, .db3): views and a data set"
        )
    )
    _add_outcomes(
        commands.add_parser(
            "import-outcomes", help="plans that were kept, and what became of them, from MLflow"
        )
    )
    verify = commands.add_parser("verify", help="check a folder's format and every file's digest")
    verify.add_argument("folder", type=Path)
    verify.set_defaults(run=lambda options: open_dataset(options.folder, verify=True))
    return result


def _add_generate(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("folder", type=Path, help="where the data set goes")
    for name, field in DatasetConfig.model_fields.items():
        if name in (*_PARTS, "outcomes"):
            continue
        choices = get_args(field.annotation)
        parser.add_argument(
            f"--{name.replace('_', '-')}",
            type=type(field.default),
            choices=choices or None,
            help=f"{field.description or ''} (default {_default(name, field.default)})".strip(),
        )
    _add_world(parser)
    parser.add_argument(
        "--scenes",
        type=Path,
        nargs="+",
        metavar="FILE",
        help="scene files or folders of them: obstacles of your own; every fifth is held out for evaluation",
    )
    parser.set_defaults(run=_generate)


def _default(name: str, planar: object) -> str:
    spatial = USUAL_OF_ARMS.get(name)
    return str(planar) if spatial is None else f"{planar}; of an arm in space {spatial}"


def _add_import(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "source",
        type=Path,
        help="name.png (depth: name.json or name.view), name.npy, optional name.collision.npy, extra/",
    )
    parser.add_argument("folder", type=Path, help="where the data set goes")
    _add_world(parser)
    parser.set_defaults(run=_import, is_foreign=True)


def _add_world(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--arm", metavar="NAME|FILE", help="a name, or what training.robots import wrote")
    parser.add_argument("--robot", type=Path, metavar="FILE", help="a scene file: robot, camera, scenes")


def _world_of(options: argparse.Namespace) -> World:
    if options.robot:
        return read_scene_file(options.robot).world
    return default_world() if options.arm is None else named_world(options.arm)


def _add_outcomes(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("folder", type=Path, help="where the data set goes")
    parser.add_argument("--site", help="plans of this place only, as outcomes name it")
    _add_world(parser)
    parser.set_defaults(run=_import_outcomes)


def _import_outcomes(options: argparse.Namespace) -> Dataset:
    # Imported here so that other commands do not wait for MLflow.
    from services.registry.tracking import Tracking  # noqa: PLC0415

    uri = tracking_uri()
    world = _world_of(options)
    return import_outcomes(options.folder, world=world, tracking=Tracking(uri), site=options.site)


def _generate(options: argparse.Namespace) -> Dataset:
    given = {name: getattr(options, name, None) for name in DatasetConfig.model_fields if name not in _PARTS}
    values = _world_parts(options) | {name: one for name, one in given.items() if one is not None}
    try:
        config = DatasetConfig.model_validate(values)
    except ValidationError as error:
        raise project_error(error, ConfigError, "the data set") from error
    # A Ray that this command starts for itself reports no use; its token mode is that of all the services.
    os.environ.setdefault("RAY_USAGE_STATS_ENABLED", "0")
    os.environ.setdefault("RAY_AUTH_MODE", "token")
    # Imported here so that import and verify do not wait for Ray.
    from training.data.generate import generate  # noqa: PLC0415

    return generate(config, options.folder.absolute())


def _world_parts(options: argparse.Namespace) -> dict[str, Any]:
    """Robot, camera and scenes of options; each given scene is taken once, where no number is asked for."""
    if not (options.robot or options.scenes):
        world = _world_of(options)
        return {"robot": world.body, **(USUAL_OF_ARMS if world.kind == "spatial" else {})}
    files = [read_scene_file(path) for path in _files(options.scenes or ())]
    first = read_scene_file(options.robot) if options.robot else files[0]
    world = first.world
    parts: dict[str, Any] = {"robot": world.body, "camera": world.sensor, "scenes": world.scenes}
    parts["robot_name"] = first.name
    if files:
        parts["scenes"] = given_scenes(world, files)
        parts |= {"scenario_count": len(parts["scenes"].train), "extra_image_count": 0}
    return parts


def _files(paths: Sequence[Path]) -> list[Path]:
    found: list[Path] = []
    for path in paths:
        inside = [one for one in sorted(path.glob("*")) if one.suffix in (".yaml", ".yml", ".json")]
        if path.is_dir() and not inside:
            raise ConfigError(f"{path} holds no scene files", expected=".yaml, .yml or .json")
        found += inside if path.is_dir() else [path]
    return found


def _import(options: argparse.Namespace) -> Dataset:
    return import_folder(options.source, options.folder, world=_world_of(options))


if __name__ == "__main__":
    sys.exit(main())
