"""Solve one problem with an API's samples.

``python -m services.planner plan scene.yaml``, or a problem of a family: ``--family narrow --seed 7``.

Exit codes: 0 solved, 1 not solved, 2 wrong usage or input, or the API refused the request.
"""

import json
import sys
from collections.abc import Sequence

from cspace.errors import CspaceError
from cspace.problem import Problem
from cspace.splits import Split
from cspace.worlds import workshop_of
from services.command_errors import tell_error
from services.planner.command_line import Command, parse_command
from services.planner.drawing.plot import draw_plan, save_figure
from services.planner.planning import Comparison, compare_with_api
from services.planner.report import comparison_json, comparison_table
from services.planner.sources.sampling_client import SamplingClient


def main(arguments: Sequence[str] | None = None) -> int:
    """Parse, draw the problem, ask, solve, print; returns the exit code."""
    try:
        command = parse_command(arguments)
        problem = _problem(command)
        obstruction = workshop_of(command.world).obstruction(problem) if command.scene else None
        if obstruction is not None:
            print(f"there is no path: {obstruction}", file=sys.stderr)
            return 1
        comparison = _compare(command, problem)
        _print(command, comparison)
        _draw(command, comparison)
    except CspaceError as error:
        return tell_error(error, CspaceError)
    return 0 if comparison.learned.result.solved else 1


def _problem(command: Command) -> Problem:
    if command.scene is not None:
        return command.scene.problem()
    workshop = workshop_of(command.world)
    return workshop.problem(command.family, Split.DEMO, command.seed, command.index)


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
