"""Solve one problem with an API's samples, or let the API plan it.

``python -m services.planner plan scene.yaml``, or a problem of a family: ``--family narrow --seed 7``. With
``--whole-plan`` the API plans by what its model predicts from the picture.

Exit codes: 0 solved, 1 not solved or the API's path collides, 2 wrong usage or input, or the API refused the
request.
"""

import argparse
import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

from cspace.errors import CspaceError, InputError
from cspace.query import DEFAULT_PATHS, PlanQuery, SampleQuery
from cspace.simulator import Problem, Split
from cspace.strict_json import parse_json
from cspace.world import World
from cspace.worlds import examples, named_world, simulator_of
from cspace_client import OutcomeSender
from services.commands import finite, report_error
from services.planner.client import DEFAULT_TIMEOUT_S, SamplingClient, usual_api
from services.planner.ompl_planner import DEFAULT_UNIFORM_SHARE
from services.planner.planning import (
    DEFAULT_SAMPLES,
    SampleRequest,
    ask_for_plan,
    compare,
    comparison_text,
    plan_text,
    problem_line,
    report_samples,
)
from services.planner.plotting import check_figure_path, plot_plan, save_figure
from services.planner.result import LEARNED_PLANNERS, RRT, PlannerSettings
from services.scene_files import SceneFile, read_scene_file

WORLDS = examples()
_CONSTRAINTS = ("limits", "upright", "unwrapped")


@dataclass(frozen=True, slots=True)
class Command:
    """What the user asked for, checked; without a scene file the problem is one of a family."""

    options: argparse.Namespace
    world: World
    settings: PlannerSettings
    request: SampleRequest
    scene: SceneFile | None
    constraints: dict[str, Any]


def parse_command(arguments: Sequence[str] | None = None) -> Command:
    """The command of an argument list; leaves the process with 2 where argparse objects."""
    given = list(sys.argv[1:] if arguments is None else arguments)
    # `plan FILE` is how people say it.
    options = make_parser().parse_args(["--scene", *given[1:]] if given[:1] == ["plan"] else given)
    scene = None if options.scene is None else read_scene_file(options.scene)
    if options.plot is not None:
        check_figure_path(options.plot)
    world = named_world(options.robot) if scene is None else scene.world
    measures = simulator_of(world).measures
    settings = PlannerSettings(
        planner=options.planner,
        range_rad=measures.range_rad if options.range is None else options.range,
        resolution_rad=measures.resolution_rad,
        time_limit_s=options.time_limit,
        max_iterations=options.max_iterations,
        seed=options.seed if options.planner_seed is None else options.planner_seed,
    )
    query = SampleQuery.checked(options.n, settings.seed, min_confidence=options.min_confidence)
    request = SampleRequest(query, options.model, with_ends=options.path_model)
    if scene is not None:
        request = request.of_robot(world, scene.name)
    elif options.robot not in WORLDS:
        request = request.of_robot(world)
    return Command(options, world, settings, request, scene, _constraints(options.constraints))


def make_parser() -> argparse.ArgumentParser:
    """The parser of the command."""
    defaults = PlannerSettings()
    parser = argparse.ArgumentParser(
        prog="python -m services.planner",
        usage="%(prog)s [plan FILE] [options]",
        description="Draw a planning problem, or read one from a scene file, ask an inference API for "
        "samples of its picture, and solve it with them and with uniform samples.",
        epilog="Exit codes: 0 solved, 1 not solved, 2 wrong usage or input, or the API refused the request. "
        "An API that does not answer is reported, and the problem is solved with uniform samples.",
    )
    problem = parser.add_argument_group("problem")
    families = dict.fromkeys(name for world in WORLDS.values() for name in simulator_of(world).families.names)
    problem.add_argument("--scene", type=Path, metavar="FILE", help="of your own, instead of a family's")
    problem.add_argument("--family", choices=list(families), default="narrow", help="default %(default)s")
    problem.add_argument("--seed", type=_count, default=0, help="of the problem; default %(default)s")
    problem.add_argument("--index", type=_count, default=0, help="of the problem among those of its seed")
    problem.add_argument(
        "--robot",
        default=next(iter(WORLDS)),
        metavar="NAME|FILE",
        help=f"{', '.join(WORLDS)}, or what python -m training.robots import wrote; default %(default)s",
    )
    samples = parser.add_argument_group("samples")
    samples.add_argument("--api", metavar="URL", default=usual_api(), help="default %(default)s")
    samples.add_argument("--timeout", type=finite, default=DEFAULT_TIMEOUT_S, help="s; default %(default)s")
    samples.add_argument(
        "--model",
        help="name, name@alias, name/version or pretrained; default the API's, with a scene file its robot's",
    )
    samples.add_argument("--n", type=_count, default=DEFAULT_SAMPLES, help="default %(default)s")
    samples.add_argument(
        "--min-confidence", type=finite, help="of the model's validity head (default: the model's own)"
    )
    samples.add_argument("--path-model", action="store_true", help="send start and goal as well")
    whole = parser.add_argument_group("whole plans")
    whole.add_argument(
        "--whole-plan",
        action="store_true",
        help="let the API plan by what its model predicts, and check the path in the true scene; of the "
        "options for samples and search --min-confidence, --time-limit and --planner-seed hold for it",
    )
    whole.add_argument("--ways", type=_count, default=DEFAULT_PATHS, help="to choose from; %(default)s")
    whole.add_argument(
        "--constraints",
        metavar="JSON",
        default="{}",
        help=f"an object of {', '.join(_CONSTRAINTS)}, as fields of POST /plan",
    )
    search = parser.add_argument_group("search")
    search.add_argument("--planner", choices=LEARNED_PLANNERS, default=RRT, help="default %(default)s")
    search.add_argument(
        "--uniform-share",
        type=_share,
        default=DEFAULT_UNIFORM_SHARE,
        help="of uniform samples mixed in; default %(default)s",
    )
    search.add_argument("--range", type=finite, help="rad; default the robot's, of two and three links 1")
    search.add_argument("--max-iterations", type=int, default=defaults.max_iterations, help="%(default)s")
    search.add_argument("--time-limit", type=finite, default=defaults.time_limit_s, help="s; %(default)s")
    search.add_argument("--planner-seed", type=_count, help="of planner and samples; default --seed")
    output = parser.add_argument_group("output")
    output.add_argument(
        "--outcomes", action="store_true", help="tell the API what the exact checks found (POST /outcomes)"
    )
    output.add_argument("--plot", type=Path, metavar="FILE", help="draw the outcome (.png, .pdf or .svg)")
    return parser


def _constraints(text: str) -> dict[str, Any]:
    try:
        values = parse_json(text.encode())
    except ValueError:
        values = None
    if not isinstance(values, dict) or not set(values) <= set(_CONSTRAINTS):
        expected = f"a JSON object of {', '.join(_CONSTRAINTS)}"
        raise InputError("the constraints do not fit", expected=expected, got=text[:200])
    return values


def _count(text: str) -> int:
    value = int(text)
    if value < 0:
        raise argparse.ArgumentTypeError(f"{value} is below 0")
    return value


def _share(text: str) -> float:
    value = float(text)
    if not 0.0 <= value <= 1.0:
        raise argparse.ArgumentTypeError(f"{text} is not within 0 to 1")
    return value


def main(arguments: Sequence[str] | None = None) -> int:
    """Parse, draw the problem, ask, solve, print; returns the exit code."""
    try:
        command = parse_command(arguments)
        problem = _problem(command)
        obstruction = simulator_of(command.world).obstruction(problem) if command.scene else None
        if obstruction is not None:
            print(f"there is no path: {obstruction}", file=sys.stderr)
            return 1
        if command.options.whole_plan:
            return _plan_whole(command, problem)
        return _compare(command, problem)
    except CspaceError as error:
        return report_error(error, CspaceError)


def _problem(command: Command) -> Problem:
    if command.scene is not None:
        return command.scene.problem()
    simulator = simulator_of(command.world)
    options = command.options
    return simulator.problem(options.family, Split.DEMO, options.seed, options.index)


def _plan_whole(command: Command, problem: Problem) -> int:
    options, settings, request = command.options, command.settings, command.request
    start, goal = (tuple(float(angle) for angle in end) for end in (problem.start, problem.goal))
    least, limit_s = request.query.min_confidence, settings.time_limit_s
    query = PlanQuery(start, goal, settings.seed, least, limit_s, options.ways, **command.constraints)
    # The search is a part of the request.
    with SamplingClient(options.api, options.timeout + limit_s) as client:
        whole = ask_for_plan(problem, client, query, request.model)
    _report(command, whole.report)
    print(plan_text(whole))
    if options.plot is not None:
        title = f"{problem_line(problem)}: {whole.found.status}"
        save_figure(plot_plan(problem, whole.result, None, title), options.plot)
    return 0 if whole.free else 1


def _compare(command: Command, problem: Problem) -> int:
    options = command.options
    with SamplingClient(options.api, options.timeout) as client:
        comparison = compare(problem, client, command.settings, command.request, options.uniform_share)
    _report(command, partial(report_samples, comparison))
    print(comparison_text(comparison))
    learned = comparison.learned
    if options.plot is not None:
        samples = None if learned.batch is None else learned.batch.samples
        save_figure(plot_plan(problem, learned.result, samples), options.plot)
        print(f"\nfigure   {options.plot}")
    return 0 if learned.result.solved else 1


def _report(command: Command, report: Callable[[OutcomeSender], None]) -> None:
    if command.options.outcomes:
        with OutcomeSender(command.options.api) as sender:
            report(sender)
        if not sender.sent:
            print("the API was not told of the outcome", file=sys.stderr)


if __name__ == "__main__":
    sys.exit(main())
