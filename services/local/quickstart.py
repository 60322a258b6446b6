"""The main job, on an example or on an arm of your own: services, training, evaluation, serving, planning."""

import os
import re
import shlex
import subprocess
import time
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

import httpx
from pydantic import BaseModel, ValidationError

from cspace.errors import ConfigError, JobError, PlanningError, ScenarioError, ServiceError
from cspace.simulator import Split
from cspace.world import World
from cspace.worlds import named_world, robot_digest, simulator_of
from services.commands import PREFIX, aligned
from services.local.stack import BIN, POLL_S, SERVICES, Report, Settings, make_state, shell_values, up
from services.names import MLFLOW_TRAINING, MODEL_NAME, label, model_name

EVALUATE = "python -m services.evaluator --model {model}"
SERVED_LIMIT_S = 60.0
PLANNING_SEED = 7
# What the planner ends with when it found no path: an outcome, which it has printed and drawn.
NOT_SOLVED = 1
COLOUR = re.compile(r"\x1b\[[0-9;]*m")


@dataclass(frozen=True)
class Tour:
    """The main job of one robot (an example's name or a file): its two jobs, and what is planned."""

    robot: str
    train: str
    evaluate: str
    families: tuple[str, ...]


TOURS = {
    "planar": Tour(
        robot="two-link",
        train="python training/cluster_train.py --preset quickstart",
        evaluate=EVALUATE,
        families=("uniform", "narrow"),
    ),
    "panda": Tour(
        robot="panda",
        train="python training/cluster_train.py --preset panda_quick",
        evaluate=f"{EVALUATE} --scenarios 20",
        families=("uniform", "shelf"),
    ),
}


class JobResult(BaseModel):
    """What a job of training or evaluation prints for programs in its last line."""

    run_id: str
    model: str
    version: int
    promoted: bool = False
    reasons: tuple[str, ...] = ()

    @property
    def reference(self) -> str:
        """``name/version``, as the API and the evaluator take it."""
        return f"{self.model}/{self.version}"


def quickstart(settings: Settings, tour: Tour, say: Report) -> None:
    """Run the main job and print its summary."""
    progress = timed(say)
    progress("starting the services")
    up(settings, SERVICES, progress)
    training = run_job(settings, tour.train, progress)
    evaluation = run_job(settings, tour.evaluate.replace("{model}", training.reference), progress)
    progress(f"waiting until the inference API serves {training.reference}")
    # The API's default is one robot's; a model of another one is asked for by its name.
    usual = training.model == MODEL_NAME
    wait_served(settings.url("api"), training.reference, default=evaluation.promoted and usual)
    folder = settings.home / "figures" / f"{training.model}-{training.version}"
    options = () if usual else ("--robot", tour.robot, "--model", training.reference)
    pictures = plan_and_draw(settings, folder, progress, tour.families, options)
    progress("done")
    rows = [
        ("version", training.reference),
        ("verdict", "champion now" if evaluation.promoted else "not promoted, the champion stays"),
        *(("", reason) for reason in evaluation.reasons),
        *(("picture", str(path)) for path in pictures),
    ]
    say(f"\n{aligned(rows)}\n\n{addresses(settings)}\n\nThe services stay up; `make down` ends them.")
    viewer = f"python -m services.planner.viewer --api {settings.url('api')} --model {training.model}"
    say(f"\nLook at what was trained: {settings.url('api') if usual else viewer}")


def timed(say: Report) -> Report:
    """Put the time since now before each line."""
    began = time.monotonic()
    return lambda line: say(f"[{time.monotonic() - began:5.1f} s] {line}")


def run_job(settings: Settings, entrypoint: str, show: Report) -> JobResult:
    """Run a job with ``ray job submit`` in the head's own folder, and show its lines."""
    command = ["ray", "job", "submit", "--log-color=false", "--", *shlex.split(entrypoint)]
    code, lines = run_shown(settings, command, show)
    if code != 0:
        remedy = "`ray job logs ID` prints all of them"
        raise JobError(f"the job `{entrypoint}` failed", got="the lines above", remedy=remedy)
    return last_result(lines)


def last_result(lines: Sequence[str]) -> JobResult:
    """The last result among a job's lines."""
    results = [line.removeprefix(PREFIX) for line in lines if line.startswith(PREFIX)]
    try:
        return JobResult.model_validate_json(results[-1])
    except (IndexError, ValidationError) as error:
        raise JobError("the job left no result", expected=f"{PREFIX}{{...}}", got=str(error)) from error


def wait_served(url: str, reference: str, *, default: bool, limit_s: float = SERVED_LIMIT_S) -> None:
    """Wait until the API serves ``name/version``, with ``default`` to requests that name no model."""
    seen = dict[str, bool]()
    for _ in range(int(limit_s / POLL_S)):
        with suppress(httpx.HTTPError, ValueError, LookupError, TypeError):
            query = {"name": reference.partition("/")[0]}
            answer = httpx.get(f"{url}/models", params=query, timeout=5.0, trust_env=False)
            seen = {one["reference"]: one["default"] for one in answer.raise_for_status().json()["models"]}
        if reference in seen and (seen[reference] or not default):
            return
        time.sleep(POLL_S)
    what = f"the inference API does not serve {reference}{' by default' if default else ''}"
    raise ServiceError(what, got=str(sorted(seen)), remedy="see api.log in the logs folder")


def plan_and_draw(
    settings: Settings, folder: Path, show: Report, families: Sequence[str], options: Sequence[str] = ()
) -> list[Path]:
    """Plan one problem of each family with the planner's command and draw it; the pictures."""
    folder.mkdir(parents=True, exist_ok=True)
    pictures = [folder / f"plan-{family}.png" for family in families]
    for family, picture in zip(families, pictures, strict=True):
        picture.unlink(missing_ok=True)
        # A process of its own: OMPL seeds its generator once a process.
        command = ["python", "-m", "services.planner", "--api", settings.url("api"), *options]
        command += ["--family", family, "--seed", str(PLANNING_SEED), "--plot", str(picture)]
        code, _ = run_shown(settings, command, show)
        # A crash ends with the same code, but draws nothing.
        if code not in (0, NOT_SOLVED) or not picture.is_file():
            raise PlanningError(f"planning failed on the family {family}", got=f"exit code {code}, see above")
    return pictures


def run_shown(settings: Settings, command: Sequence[str], show: Report) -> tuple[int, list[str]]:
    """Run a command and show its lines, but not those for programs; its exit code and all lines."""
    show(f"$ {shlex.join(command)}")
    lines, environment = [], os.environ | shell_values(settings)
    program = [str(BIN / command[0]), *command[1:]]
    with subprocess.Popen(
        program, env=environment, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True
    ) as process:
        for line in process.stdout or ():
            lines.append(COLOUR.sub("", line.rstrip()))
            if lines[-1] and not lines[-1].startswith(PREFIX):
                show(f"  {lines[-1]}")
    return process.returncode, lines


def addresses(settings: Settings) -> str:
    """Where to look, and how to set a shell up for jobs of one's own."""
    rows = [
        ("workbench", f"{settings.url('api')}/"),
        ("API", f"{settings.url('api')}/docs"),
        ("MLflow", f"{settings.url('mlflow')}/#/experiments/1/runs?{MLFLOW_TRAINING}"),
        ("Ray dashboard", f"{settings.url('ray')}  (asks for the token: `ray get-auth-token` prints it)"),
        ("a shell for `ray job submit`", 'eval "$(.venv/bin/python -m services.local env)"'),
    ]
    return aligned(rows)


def import_arm(settings: Settings, urdf: Path, options: Sequence[str], say: Report) -> Path:
    """Import a description with the options of ``python -m training.robots import``; the robot's file."""
    make_state(settings)
    file = settings.home / "arms" / f"{urdf.name.partition('.')[0]}.json"
    command = ["python", "-m", "training.robots", "import", str(urdf), *options, "--out", str(file)]
    if run_shown(settings, command, timed(say))[0] != 0:
        remedy = "see docs/arm-in-space.md for what it does with each part of a description"
        raise ConfigError(f"{urdf} was not imported", got="the error above", remedy=remedy)
    # Named as the model is: an import under another name leaves this file to its model.
    named = file.with_name(f"{_name(named_world(str(file)))}.json")
    return file.replace(named)


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
    command = ["python", "-m", "training.untrained", str(file), str(folder), "--register", "champion"]
    code, lines = run_shown(settings, command, progress)
    if code != 0:
        raise JobError("the model was not made", got=f"exit code {code}, the lines above")
    reference = lines[-1].split()[-1]
    progress(f"waiting until the inference API serves {reference}")
    wait_served(settings.url("api"), reference, default=False)
    options = ("--robot", str(file), "--whole-plan")
    try:
        simulator_of(world).problem("table", Split.DEMO, PLANNING_SEED)
    except ScenarioError as error:
        # Tables are of one size, and a small arm may not reach round what stands on them.
        say(f"The model is served. There is no plan to show: {error}")
    else:
        pictures = settings.home / "figures" / f"{name}-untrained"
        plan_and_draw(settings, pictures, progress, ("table",), options)
    model = model_name(world, name)
    say(f"\n{addresses(settings)}\n\nPOST /plan, /validity and /sample take model={model}.")
    say(f"Look at it: python -m services.planner.viewer --api {settings.url('api')} --model {model}")


def _name(world: World) -> str:
    name = label(world)
    if name is None:
        remedy = "give it one of letters, digits and dashes, which no example has, with --name"
        raise ScenarioError("the robot has no name for a model of its own", remedy=remedy)
    return name
