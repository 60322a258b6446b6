"""Solve one problem with an API's samples, or let the API plan it.

``python -m services.planner plan scene.yaml``, or a problem of a family: ``--family narrow --seed 7``. With
``--whole-plan`` the API plans in what its model believes of the picture.

Exit codes: 0 solved, 1 not solved or the API's way collides, 2 wrong usage or input, or the API refused the
request.
"""

import json
import sys
from collections.abc import Sequence

from cspace.errors import CspaceError
from cspace.query import PlanQuery
from cspace.simulator import Problem, Split
from cspace.worlds import simulator_of
from services.command_errors import tell_error
from services.planner.command_line import Command, parse_command
from services.planner.drawing.plot import draw_plan, save_figure
from services.planner.planning import Comparison, compare_with_api
from services.planner.report import comparison_json, comparison_table, problem_line
from services.planner.sources.sampling_client import SamplingClient
from services.planner.whole_plan import as_json, ask_for_plan, told


def main(arguments: Sequence[str] | None = None) -> int:
    """Parse, draw the problem, ask, solve, print; returns the exit code."""
    try:
        command = parse_command(arguments)
        problem = _problem(command)
        obstruction = simulator_of(command.world).obstruction(problem) if command.scene else None
        if obstruction is not None:
            print(f"there is no path: {obstruction}", file=sys.stderr)
            return 1
        if command.whole:
            return _plan_whole(command, problem)
        comparison = _compare(command, problem)
        _print(command, comparison)
        _draw(command, comparison)
    except CspaceError as error:
        return tell_error(error, CspaceError)
    return 0 if comparison.learned.result.solved else 1


def _problem(command: Command) -> Problem:
    if command.scene is not None:
        return command.scene.problem()
    simulator = simulator_of(command.world)
    return simulator.problem(command.family, Split.DEMO, command.seed, command.index)


def _plan_whole(command: Command, problem: Problem) -> int:
    settings, asked = command.settings, command.request
    start, goal = (tuple(float(angle) for angle in end) for end in (problem.start, problem.goal))
    least, limit_s = asked.query.min_confidence, settings.time_limit_s
    query = PlanQuery(start, goal, settings.seed, least, limit_s, command.ways)
    # The search is a part of the request.
    timeout_s = command.timeout_s + settings.time_limit_s
    with SamplingClient(command.url, timeout_s) as client:
        whole = ask_for_plan(problem, client, query, asked.model)
    print(json.dumps(as_json(whole), allow_nan=False) if command.json else told(whole))
    if command.plot is not None:
        title = f"{problem_line(problem)}: {whole.found.plan.status}"
        save_figure(draw_plan(problem, whole.result, None, title), command.plot)
    return 0 if whole.free else 1


def _compare(command: Command, problem: Problem) -> Comparison:
    with SamplingClient(command.url, command.timeout_s) as client:
        return compare_with_api(problem, client, command.settings, command.request, command.uniform_share)


def _print(command: Command, comparison: Comparison) -> None:
    planner = command.settings.planner
    if command.json:
        print(json.dumps(comparison_json(comparison, planner), allow_nan=False))
    else:
        print(comparison_table(comparison, planner))


def _draw(command: Command, comparison: Comparison) -> None:
    if command.plot is None:
        return
    learned = comparison.learned
    samples = None if learned.batch is None else learned.batch.samples
    save_figure(draw_plan(comparison.problem, learned.result, samples), command.plot)
    if not command.json:
        print(f"\nfigure   {command.plot}")


if __name__ == "__main__":
    sys.exit(main())
