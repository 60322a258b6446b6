"""From an arm's description to a served model: import, then the main job with that robot."""

import shlex
import subprocess
import sys
from collections.abc import Callable, Sequence
from pathlib import Path

from cspace.errors import ConfigError, ScenarioError
from cspace.worlds import named_world, robot_digest
from services.local.quickstart import EVALUATE, Progress, Tour
from services.local.settings import Settings
from services.names import label

PRESET = "panda_quick"
SCENARIOS = 20


def import_arm(settings: Settings, urdf: Path, options: Sequence[str], say: Callable[[str], None]) -> Path:
    """Import a description as ``python -m training.robots import`` does; the robot's file.

    Args:
        settings: the file goes to ``arms`` in its state folder.
        urdf: URDF or xacro file.
        options: of that command, such as ``--tip LINK``.
        say: takes its lines.

    Raises:
        ConfigError: a file or an option was refused, and the reason has been said.
        StorageError: the state folder cannot be made.
    """
    settings.make_folders()
    file = settings.arms_folder / f"{urdf.name.partition('.')[0]}.json"
    command = [sys.executable, "-m", "training.robots", "import", str(urdf), *options, "--out", str(file)]
    progress = Progress(say)
    progress.stage(f"import: {shlex.join(command[1:])}")
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True) as process:
        for line in process.stdout or ():
            progress.line(line.rstrip())
    if process.returncode != 0:
        raise ConfigError(
            f"{urdf} was not imported",
            expected="a description and options that the import takes",
            got="the error above",
            remedy="see docs/arm-in-space.md for what it does with each part of a description",
        )
    return file


def tour_of_arm(file: Path) -> Tour:
    """The main job of a robot's file; submitted again, its training goes on where it stopped.

    Raises:
        ConfigError: the file cannot be read.
        ScenarioError: its robot cannot be, or is one whose model ships.
    """
    world = named_world(str(file))
    name = label(world)
    if name is None:
        raise ScenarioError(
            "the robot has no name for a model of its own",
            expected="one of letters, digits and dashes that no robot of an example has",
            got=repr(getattr(world.body, "name", "")),
            remedy="give it one with --name",
        )
    job = f"arm-{name[:40]}-{robot_digest(world)[:8]}"
    robot = shlex.quote(f"data.robot={file}")
    return Tour(
        robot=str(file),
        shipped=None,
        train=f"python training/cluster_train.py --preset {PRESET} --job {job} --set {robot}",
        evaluate=f"{EVALUATE} --scenarios {SCENARIOS}",
        scenarios=SCENARIOS,
        families=("table", "shelf"),
    )
