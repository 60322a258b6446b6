"""From an arm's description to a served model: import, then the main job with that robot, or no training."""

import shlex
import sys
from collections.abc import Sequence
from pathlib import Path

from cspace.errors import ConfigError, JobError, ScenarioError
from cspace.world import World
from cspace.worlds import named_world, robot_digest
from services.local.quickstart import EVALUATE, Tour, addresses, plan_and_draw, run_shown, timed, wait_served
from services.local.settings import Settings, make_state
from services.local.stack import SERVICES, Report, up
from services.names import label, model_name


def import_arm(settings: Settings, urdf: Path, options: Sequence[str], say: Report) -> Path:
    """Import a description with the options of ``python -m training.robots import``; the robot's file."""
    make_state(settings)
    file = settings.home / "arms" / f"{urdf.name.partition('.')[0]}.json"
    command = [sys.executable, "-m", "training.robots", "import", str(urdf), *options, "--out", str(file)]
    if run_shown(settings, command, timed(say))[0] != 0:
        remedy = "see docs/arm-in-space.md for what it does with each part of a description"
        raise ConfigError(f"{urdf} was not imported", got="the error above", remedy=remedy)
    # Named as the model is: an import under another name leaves this file to its model.
    named = file.with_name(f"{_name(named_world(str(file)))}.json")
    for end in (".json", ".report.json", ".report.png"):
        file.with_suffix(end).replace(named.with_suffix(end))
    return named


def tour_of_arm(file: Path) -> Tour:
    """The main job of a robot's file; submitted again, its training goes on where it stopped."""
    world = named_world(str(file))
    job = f"arm-{_name(world)[:40]}-{robot_digest(world)[:8]}"
    robot = shlex.quote(f"data.robot={file}")
    return Tour(
        robot=str(file),
        train=f"python training/cluster_train.py --preset panda_quick --job {job} --set {robot}",
        evaluate=f"{EVALUATE} --scenarios 20",
        families=("table", "shelf"),
    )


def serve_untrained(settings: Settings, file: Path, say: Report) -> None:
    """Serve a robot's file by the shipped scene model, without training, and plan a problem with it."""
    world, progress = named_world(str(file)), timed(say)
    name = _name(world)
    progress("starting the services")
    up(settings, SERVICES, progress)
    folder = settings.home / "arms" / f"{name}-untrained-{robot_digest(world)[:8]}"
    command = [sys.executable, "-m", "training.untrained", str(file), str(folder), "--register", "champion"]
    code, lines = run_shown(settings, command, progress)
    if code != 0:
        raise JobError("the model was not made", got=f"exit code {code}, the lines above")
    reference = lines[-1].split()[-1]
    progress(f"waiting until the inference API serves {reference}")
    wait_served(settings.url("api"), reference, default=False)
    options = ("--robot", str(file), "--whole-plan")
    plan_and_draw(settings, settings.home / "figures" / f"{name}-untrained", progress, ("table",), options)
    model = model_name(world, name)
    say(f"\n{addresses(settings)}\n\nPOST /plan, /validity and /sample take model={model}.")
    say(f"Look at it: python -m services.planner.viewer --api {settings.url('api')} --model {model}")


def _name(world: World) -> str:
    name = label(world)
    if name is None:
        remedy = "give it one of letters, digits and dashes, which no example has, with --name"
        raise ScenarioError("the robot has no name for a model of its own", remedy=remedy)
    return name
