"""Solve one problem with an API's samples, or let the API plan it.

``python -m services.planner plan scene.yaml``, or a problem of a family: ``--family narrow --seed 7``. With
``--whole-plan`` the API plans by what its model predicts from the picture.
"""

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

from cspace.errors import CspaceError
from cspace.query import PlanQuery, SampleQuery
from cspace.simulator import Problem, Split
from cspace.worlds import examples, named_world, simulator_of
from cspace_client import DEFAULT_TIMEOUT_S
from services.commands import ANY_SEED, COUNT, POSITIVE, SHARE, report_error
from services.planner.planning import (
    DEFAULT_SAMPLES,
    SampleRequest,
    ask_for_plan,
    compare,
    comparison_text,
    plan_text,
    problem_line,
)
from services.planner.plotting import check_figure_path, plot_plan, save_figure
from services.planner.result import LEARNED_PLANNERS, RRT, PlannerSettings
from services.planner.samples import SamplingClient, usual_api
from services.scene_files import read_scene_file

WORLDS = examples()


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
            problem = simulator.problem(options.family, Split.DEMO, options.seed)
        else:
            problem = scene.problem()
            if (obstruction := simulator.obstruction(problem)) is not None:
                print(f"there is no path: {obstruction}", file=sys.stderr)
                return 1
        query = SampleQuery.checked(options.n, options.seed, min_confidence=options.min_confidence)
        request = SampleRequest(query, options.model, with_ends=options.path_model)
        if scene is not None or options.robot not in WORLDS:
            # A robot of one's own has its own model.
            request = request.of_robot(world, None if scene is None else scene.name)
        return (_plan_whole if options.whole_plan else _compare)(options, problem, request)
    except CspaceError as error:
        return report_error(error, CspaceError)


def make_parser() -> argparse.ArgumentParser:
    """The parser of the command."""
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
    problem("--seed", type=ANY_SEED, default=0, help="of problem, samples and search; default %(default)s")
    robots = f"{', '.join(WORLDS)}, or what python -m training.robots import wrote; default %(default)s"
    problem("--robot", default=next(iter(WORLDS)), metavar="NAME|FILE", help=robots)
    samples = parser.add_argument_group("samples").add_argument
    samples("--api", metavar="URL", default=usual_api(), help="default %(default)s")
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
        "options for samples and search --min-confidence and --time-limit hold for it",
    )
    search = parser.add_argument_group("search").add_argument
    search("--planner", choices=LEARNED_PLANNERS, default=RRT, help="default %(default)s")
    search("--time-limit", type=POSITIVE, default=10.0, help="s; default %(default)s")
    output = parser.add_argument_group("output").add_argument
    output("--plot", type=Path, metavar="FILE", help="draw the outcome (.png, .pdf or .svg)")
    return parser


def _plan_whole(options: argparse.Namespace, problem: Problem, request: SampleRequest) -> int:
    start, goal = (tuple(float(angle) for angle in end) for end in (problem.start, problem.goal))
    query = PlanQuery(start, goal, options.seed, options.min_confidence, options.time_limit)
    # The search is a part of the request.
    with SamplingClient(options.api, DEFAULT_TIMEOUT_S + options.time_limit) as client:
        whole = ask_for_plan(problem, client, query, request.model)
    print(plan_text(whole))
    if options.plot is not None:
        title = f"{problem_line(problem)}: {whole.found.status}"
        save_figure(plot_plan(problem, whole.result, None, title), options.plot)
    return 0 if whole.free else 1


def _compare(options: argparse.Namespace, problem: Problem, request: SampleRequest) -> int:
    measures = simulator_of(problem.scenario.world).measures
    settings = PlannerSettings(
        planner=options.planner,
        range_rad=measures.range_rad,
        resolution_rad=measures.resolution_rad,
        time_limit_s=options.time_limit,
        seed=options.seed,
    )
    with SamplingClient(options.api) as client:
        comparison = compare(problem, client, settings, request)
    print(comparison_text(comparison))
    learned = comparison.learned
    if options.plot is not None:
        samples = None if learned.batch is None else learned.batch.samples
        save_figure(plot_plan(problem, learned.result, samples), options.plot)
        print(f"\nfigure   {options.plot}")
    return 0 if learned.result.solved else 1


if __name__ == "__main__":
    sys.exit(main())
