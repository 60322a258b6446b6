"""Solve one problem with an API's samples, or let the API plan it.

``python -m services.planner plan scene.yaml``, or a problem of a family: ``--family narrow --seed 7``. With
``--whole-plan`` the API plans by what its model predicts from the picture.

Exit codes: 0 solved, 1 not solved or the API's path collides, 2 wrong usage or input, or the API refused the
request.
"""

import argparse
import sys
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import Any

from cspace.errors import CspaceError
from cspace.files import parse_json
from cspace.query import DEFAULT_PATHS, PlanQuery, SampleQuery
from cspace.simulator import Problem, Split
from cspace.world import World
from cspace.worlds import examples, named_world, simulator_of
from cspace_client import DEFAULT_TIMEOUT_S, OutcomeSender
from services.commands import ANY_SEED, COUNT, POSITIVE, SHARE, report_error
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
from services.planner.samples import SamplingClient, usual_api
from services.scene_files import SceneFile, read_scene_file

WORLDS = examples()
_CONSTRAINTS = ("limits", "upright", "unwrapped")


def main(arguments: Sequence[str] | None = None) -> int:
    """Parse, make the problem, ask, solve, print; returns the exit code."""
    given = list(sys.argv[1:] if arguments is None else arguments)
    # `plan FILE` is how people say it.
    options = make_parser().parse_args(["--scene", *given[1:]] if given[:1] == ["plan"] else given)
    try:
        if options.plot is not None:
            check_figure_path(options.plot)
        scene = None if options.scene is None else read_scene_file(options.scene)
        world = named_world(options.robot) if scene is None else scene.world
        simulator = simulator_of(world)
        if scene is None:
            problem = simulator.problem(options.family, Split.DEMO, options.seed, options.index)
        else:
            problem = scene.problem()
            if (obstruction := simulator.obstruction(problem)) is not None:
                print(f"there is no path: {obstruction}", file=sys.stderr)
                return 1
        request = sample_request(options, world, scene)
        return (_plan_whole if options.whole_plan else _compare)(options, problem, request)
    except CspaceError as error:
        return report_error(error, CspaceError)


def sample_request(
    options: argparse.Namespace, world: World, scene: SceneFile | None = None
) -> SampleRequest:
    """What is asked of the API; a robot of one's own has its own model."""
    query = SampleQuery.checked(options.n, _planner_seed(options), min_confidence=options.min_confidence)
    request = SampleRequest(query, options.model, with_ends=options.path_model)
    if scene is None and options.robot in WORLDS:
        return request
    return request.of_robot(world, None if scene is None else scene.name)


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
    problem = parser.add_argument_group("problem").add_argument
    families = dict.fromkeys(name for world in WORLDS.values() for name in simulator_of(world).families.names)
    problem("--scene", type=Path, metavar="FILE", help="of your own, instead of a family's")
    problem("--family", choices=list(families), default="narrow", help="default %(default)s")
    problem("--seed", type=ANY_SEED, default=0, help="of the problem; default %(default)s")
    problem("--index", type=ANY_SEED, default=0, help="of the problem among those of its seed")
    robots = f"{', '.join(WORLDS)}, or what python -m training.robots import wrote; default %(default)s"
    problem("--robot", default=next(iter(WORLDS)), metavar="NAME|FILE", help=robots)
    samples = parser.add_argument_group("samples").add_argument
    samples("--api", metavar="URL", default=usual_api(), help="default %(default)s")
    samples("--timeout", type=POSITIVE, default=DEFAULT_TIMEOUT_S, help="s; default %(default)s")
    model = "name, name@alias, name/version or pretrained; default the API's, with a scene file its robot's"
    samples("--model", help=model)
    samples("--n", type=COUNT, default=DEFAULT_SAMPLES, help="default %(default)s")
    samples("--min-confidence", type=SHARE, help="of the model's validity head (default: the model's own)")
    samples("--path-model", action="store_true", help="send start and goal as well")
    whole = parser.add_argument_group("whole plans").add_argument
    whole(
        "--whole-plan",
        action="store_true",
        help="let the API plan by what its model predicts, and check the path in the true scene; of the "
        "options for samples and search --min-confidence, --time-limit and --planner-seed hold for it",
    )
    whole("--ways", type=COUNT, default=DEFAULT_PATHS, help="to choose from; %(default)s")
    fields = f"an object of {', '.join(_CONSTRAINTS)}, as fields of POST /plan"
    whole("--constraints", type=_constraints, metavar="JSON", default="{}", help=fields)
    search = parser.add_argument_group("search").add_argument
    search("--planner", choices=LEARNED_PLANNERS, default=RRT, help="default %(default)s")
    mixed = "of uniform samples mixed in; default %(default)s"
    search("--uniform-share", type=SHARE, default=DEFAULT_UNIFORM_SHARE, help=mixed)
    search("--range", type=POSITIVE, help="rad; default the robot's, of two and three links 1")
    search("--max-iterations", type=COUNT, default=defaults.max_iterations, help="%(default)s")
    search("--time-limit", type=POSITIVE, default=defaults.time_limit_s, help="s; %(default)s")
    search("--planner-seed", type=ANY_SEED, help="of planner and samples; default --seed")
    output = parser.add_argument_group("output").add_argument
    output(
        "--outcomes", action="store_true", help="tell the API what the exact checks found (POST /outcomes)"
    )
    output("--plot", type=Path, metavar="FILE", help="draw the outcome (.png, .pdf or .svg)")
    return parser


def _constraints(text: str) -> dict[str, Any]:
    values = parse_json(text.encode())
    if not isinstance(values, dict) or not set(values) <= set(_CONSTRAINTS):
        raise argparse.ArgumentTypeError(f"expected a JSON object of {', '.join(_CONSTRAINTS)}")
    return values


def _planner_seed(options: argparse.Namespace) -> int:
    return int(options.seed if options.planner_seed is None else options.planner_seed)


def _plan_whole(options: argparse.Namespace, problem: Problem, request: SampleRequest) -> int:
    start, goal = (tuple(float(angle) for angle in end) for end in (problem.start, problem.goal))
    least, limit_s, seed = request.query.min_confidence, options.time_limit, request.query.seed
    query = PlanQuery(start, goal, seed, least, limit_s, options.ways, **options.constraints)
    # The search is a part of the request.
    with SamplingClient(options.api, options.timeout + limit_s) as client:
        whole = ask_for_plan(problem, client, query, request.model)
    _report(options, whole.report)
    print(plan_text(whole))
    if options.plot is not None:
        title = f"{problem_line(problem)}: {whole.found.status}"
        save_figure(plot_plan(problem, whole.result, None, title), options.plot)
    return 0 if whole.free else 1


def _compare(options: argparse.Namespace, problem: Problem, request: SampleRequest) -> int:
    measures = simulator_of(problem.scenario.world).measures
    settings = PlannerSettings(
        planner=options.planner,
        range_rad=options.range or measures.range_rad,
        resolution_rad=measures.resolution_rad,
        time_limit_s=options.time_limit,
        max_iterations=options.max_iterations,
        seed=_planner_seed(options),
    )
    with SamplingClient(options.api, options.timeout) as client:
        comparison = compare(problem, client, settings, request, options.uniform_share)
    _report(options, partial(report_samples, comparison))
    print(comparison_text(comparison))
    learned = comparison.learned
    if options.plot is not None:
        samples = None if learned.batch is None else learned.batch.samples
        save_figure(plot_plan(problem, learned.result, samples), options.plot)
        print(f"\nfigure   {options.plot}")
    return 0 if learned.result.solved else 1


def _report(options: argparse.Namespace, report: Callable[[OutcomeSender], None]) -> None:
    if options.outcomes:
        with OutcomeSender(options.api) as sender:
            report(sender)
        if not sender.sent:
            print("the API was not told of the outcome", file=sys.stderr)


if __name__ == "__main__":
    sys.exit(main())
