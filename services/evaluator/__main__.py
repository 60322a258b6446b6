"""Evaluate a registered version: ``python -m services.evaluator --model cspace-sampler@challenger``.

Exit codes: 0 evaluated, whether promoted or not; 1 the evaluation failed; 2 the request was wrong.
"""

import argparse
import os
import sys
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from pathlib import Path

from cspace.errors import ConfigError, CspaceError, InputError, ModelNotFoundError
from services.commands import report_error, report_result
from services.evaluator import compare, recalibrate
from services.evaluator.benchmark.__main__ import main as planning_benchmark
from services.evaluator.evaluation import BUDGETS, run_metrics
from services.evaluator.job import Outcome, evaluate_version, executor, make_request
from services.evaluator.report import REPORT_FOLDER, scenes_text, terminal_table
from services.registry import connect, tracking_uri

SHIPPED_FOLDER = Path(__file__).parents[2] / "inference_api" / "pretrained"
COMMANDS: Mapping[str, Callable[[Sequence[str], Mapping[str, str]], int]] = {
    "planning": planning_benchmark,
    "compare": compare.main,
    "recalibrate": recalibrate.main,
    "card": compare.print_card,
}


def main(arguments: Sequence[str] | None = None, environment: Mapping[str, str] = os.environ) -> int:
    """Run a command, or evaluate; returns the exit code."""
    given = list(sys.argv[1:] if arguments is None else arguments)
    try:
        if given and given[0] in COMMANDS:
            return COMMANDS[given[0]](given[1:], environment)
        return _evaluate(_parser().parse_args(given), environment)
    except CspaceError as error:
        return report_error(error, ConfigError, InputError, ModelNotFoundError)


def _evaluate(options: argparse.Namespace, environment: Mapping[str, str]) -> int:
    shipped = Path(environment.get("CSPACE_PRETRAINED_MODEL") or SHIPPED_FOLDER)
    request = make_request(
        options.model,
        budget=options.budget,
        scenarios=options.scenarios,
        seed=options.seed,
        promote=not options.no_promote,
        data=options.data,
        shipped=None if options.without_shipped else shipped,
    )
    tracking, registry = connect(tracking_uri(environment))
    outcome = evaluate_version(request, tracking, registry, executor(environment), partial(print, flush=True))
    _print(outcome)
    data = Path(environment.get("CSPACE_DATA_DIR", ""))
    folder = data / "jobs" / outcome.run_id if data.is_absolute() else None
    report_result(_result(outcome), _rows(outcome), folder)
    return 0


def _result(outcome: Outcome) -> dict[str, object]:
    version, verdict = outcome.version, outcome.verdict
    return {
        "run_id": outcome.run_id,
        "model": version.name,
        "version": version.number,
        "digest": version.digest,
        "promoted": verdict.promoted and outcome.recorded,
        "recorded": outcome.recorded,
        "judged_on": scenes_text(outcome.evaluation.setting),
        "reasons": list(verdict.reasons),
        "metrics": run_metrics(outcome.evaluation),
        "figures": list(outcome.figures),
    }


def _rows(outcome: Outcome) -> dict[str, str]:
    version, promoted = outcome.version, outcome.verdict.promoted and outcome.recorded
    return {
        "model": f"{version}, digest {version.digest[:12]}",
        "promoted": "yes, it is the champion" if promoted else "no",
        "run": outcome.run_id,
        "report": f"{REPORT_FOLDER}/evaluation.md among the run's artifacts",
    }


def _print(outcome: Outcome) -> None:
    print(f"\n{scenes_text(outcome.evaluation.setting)}")
    print(f"\n{terminal_table(outcome.evaluation, outcome.verdict.bar.comparisons)}\n")
    moved = "promoted" if outcome.verdict.promoted else "not promoted"
    print(f"{moved}{'' if outcome.recorded else ' (evaluated only, nothing recorded)'}:")
    for reason in outcome.verdict.reasons:
        print(f"  {reason}")


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="python -m services.evaluator",
        description="Evaluate a version on scenarios it was never trained on; promote it if the gate holds.",
        epilog=f"Other commands: {', '.join(COMMANDS)}, each with --help. "
        "Exit codes: 0 evaluated (promoted or not), 1 evaluation failed, 2 wrong request.",
    )
    parser.add_argument("--model", default="cspace-sampler@challenger", help="name@alias or name/version")
    parser.add_argument("--budget", choices=sorted(BUDGETS), default="quick", help="how much is evaluated")
    parser.add_argument("--scenarios", type=int, help="per split, instead of the budget's")
    parser.add_argument("--seed", type=int, default=0, help="of scenarios, samples and problems")
    parser.add_argument(
        "--data",
        type=Path,
        metavar="FOLDER",
        help="a data set: evaluate on its scenes, not on the version's own",
    )
    parser.add_argument("--no-promote", action="store_true", help="record no decision, move no alias")
    parser.add_argument(
        "--without-shipped",
        action="store_true",
        help="let a version become the champion that may be worse than the shipped model",
    )
    return parser


if __name__ == "__main__":
    sys.exit(main())
