"""From an arm's description to a served model: import, then the main job with that robot, or no training."""

import shlex
import sys
from collections.abc import Callable, Sequence
from pathlib import Path

from cspace.errors import ConfigError, JobError, ScenarioError
from cspace.world import World
from cspace.worlds import named_world, robot_digest
from services.local.quickstart import EVALUATE, Progress, Tour, plan_and_draw, run_shown, wait_served
from services.local.settings import Settings, service_environment
from services.local.stack import addresses, services, up
from services.names import label, model_name

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
    if run_shown(command, progress.line)[0] != 0:
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
    name = _name(world)
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


def serve_untrained(settings: Settings, file: Path, say: Callable[[str], None]) -> None:
    """Serve a robot's file by the shipped scene model, without training, and plan a problem with it.

    Args:
        settings: of the services, which are started.
        file: the robot's.
        say: takes lines for people.

    Raises:
        ConfigError: the file cannot be read.
        ScenarioError: its robot cannot be, or is one whose model ships.
        JobError: the model was not made.
        PlanningError: the planner failed.
        CspaceError: another stage failed.
    """
    world = named_world(str(file))
    name, model = _name(world), model_name(world, _name(world))
    progress = Progress(say)
    progress.stage("starting the services")
    up(settings, services(settings), progress.line)
    environment = service_environment(settings)
    folder = settings.arms_folder / f"{name}-untrained-{robot_digest(world)[:8]}"
    command = [sys.executable, "-m", "training.untrained", str(file), str(folder), "--register", "champion"]
    progress.stage(shlex.join(command[1:]))
    code, last = run_shown(command, progress.line, environment)
    if code != 0:
        raise JobError("the model was not made", got=f"exit code {code}, the lines above")
    reference = last.split()[-1]
    progress.stage(f"waiting until the inference API serves {reference}")
    wait_served(settings.api_url, reference, default=False)
    progress.stage("planning with POST /plan")
    folder, options = settings.figures_folder / f"{name}-untrained", ("--robot", str(file), "--whole-plan")
    plan_and_draw(settings.api_url, folder, environment, progress.line, ("table",), options)
    progress.stage("done")
    say(f"\n{addresses(settings)}\n\nThe services stay up; `make down` ends them.")
    say(f"POST /plan, /validity and /sample take model={model}.")
    say(f"\nLook at it: python -m services.planner.viewer --api {settings.api_url} --model {model}")


def _name(world: World) -> str:
    name = label(world)
    if name is None:
        raise ScenarioError(
            "the robot has no name for a model of its own",
            expected="one of letters, digits and dashes that no robot of an example has",
            got=repr(getattr(world.body, "name", "")),
            remedy="give it one with --name",
        )
    return name
