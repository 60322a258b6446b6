"""Evaluate a registered version: ``python -m services.evaluator --model cspace-sampler@challenger``."""

import argparse
import os
import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path

from cspace.errors import ConfigError, CspaceError, InputError, ModelNotFoundError
from services.commands import ANY_SEED, COUNT, report_error, report_result
from services.evaluator import recalibrate
from services.evaluator.benchmark.__main__ import main as planning_benchmark
from services.evaluator.evaluation import BUDGETS, run_metrics
from services.evaluator.job import Outcome, Request, evaluate_version, executor
from services.evaluator.report import REPORT_FOLDER, scenes_text, terminal_table
from services.registry import connect, tracking_uri
from services.registry.entities import ModelReference

COMMANDS: Mapping[str, Callable[[Sequence[str], Mapping[str, str]], int]] = {
    "planning": planning_benchmark,
    "recalibrate": recalibrate.main,
}


def main(arguments: Sequence[str] | None = None, environment: Mapping[str, str] = os.environ) -> int:
    """Run a command, or evaluate; returns the exit code."""
    given = list(sys.argv[1:] if arguments is None else arguments)
    try:
        if given and given[0] in COMMANDS:
            return COMMANDS[given[0]](given[1:], environment)
        request = make_request(_parser().parse_args(given))
        show = partial(print, flush=True)
        outcome = evaluate_version(request, *connect(tracking_uri(environment)), executor(environment), show)
    except CspaceError as error:
        return report_error(error, ConfigError, InputError, ModelNotFoundError)
    _report(outcome, environment)
    return 0


def make_request(options: argparse.Namespace) -> Request:
    """What the options ask for."""
    budget = BUDGETS[options.budget]
    return Request(
        ModelReference.parse_version(options.model, "the model reference is unknown"),
        budget if options.scenarios is None else replace(budget, scenarios=options.scenarios),
        options.seed,
    )


def _report(outcome: Outcome, environment: Mapping[str, str]) -> None:
    version, verdict, scenes = outcome.version, outcome.verdict, scenes_text(outcome.evaluation.setting)
    moved = "promoted" if verdict.promoted else "not promoted"
    print(f"\n{scenes}\n\n{terminal_table(outcome.evaluation, verdict.bar.comparisons)}\n")
    print(f"{moved}:")
    print("\n".join(f"  {reason}" for reason in verdict.reasons))
    result = {
        "run_id": outcome.run_id,
        "model": version.name,
        "version": version.number,
        "digest": version.digest,
        "promoted": verdict.promoted,
        "judged_on": scenes,
        "reasons": list(verdict.reasons),
        "metrics": run_metrics(outcome.evaluation),
        "figures": list(outcome.figures),
    }
    rows = {
        "model": f"{version}, digest {version.digest[:12]}",
        "promoted": "yes, it is the champion" if verdict.promoted else "no",
        "run": outcome.run_id,
        "report": f"{REPORT_FOLDER}/evaluation.md among the run's artifacts",
    }
    data = Path(environment.get("CSPACE_DATA_DIR", ""))
    report_result(result, rows, data / "jobs" / outcome.run_id if data.is_absolute() else None)


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="python -m services.evaluator",
        description="Evaluate a version on scenarios it was never trained on; promote it if the gate holds.",
        epilog=f"Other commands: {', '.join(COMMANDS)}, each with --help. "
        "Exit codes: 0 evaluated (promoted or not), 1 evaluation failed, 2 wrong request.",
    )
    add = parser.add_argument
    add("--model", default="cspace-sampler@challenger", help="name@alias or name/version")
    add("--budget", choices=sorted(BUDGETS), default="quick", help="how much is evaluated")
    add("--scenarios", type=COUNT, help="per split, instead of the budget's")
    add("--seed", type=ANY_SEED, default=0, help="of scenarios, samples and problems")
    return parser


if __name__ == "__main__":
    sys.exit(main())
