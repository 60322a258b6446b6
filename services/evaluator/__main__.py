"""Evaluate a registered version: ``python -m services.evaluator --model cspace-sampler@challenger``.

``python -m services.evaluator planning`` is the planning benchmark (:mod:`services.evaluator.benchmark`),
``python -m services.evaluator compare A B`` sets versions side by side (:mod:`services.evaluator.compare`),
``python -m services.evaluator recalibrate`` refits confidence (:mod:`services.evaluator.recalibrate`),
``python -m services.evaluator card MODEL`` prints a model card (:mod:`services.evaluator.model_card`).

Exit codes: 0 evaluated, whether promoted or not; 1 the evaluation failed; 2 the request was wrong.
"""

import argparse
import os
import sys
from collections.abc import Mapping, Sequence
from functools import partial
from pathlib import Path

from cspace.errors import ConfigError, CspaceError, InputError, ModelNotFoundError
from services.command_errors import report_error
from services.evaluator import compare, model_card, recalibrate
from services.evaluator.benchmark.__main__ import main as planning_benchmark
from services.evaluator.evaluation.job import Outcome, evaluate_version, executor
from services.evaluator.evaluation.measured import flat_metrics
from services.evaluator.evaluation.report import REPORT_FOLDER, scenes_text, terminal_table
from services.evaluator.evaluation.units import BUDGETS, make_request
from services.evaluator.tables import aligned
from services.registry.entities import ModelReference
from services.registry.models import ModelRegistry
from services.registry.tracking import Tracking
from services.results import report_result

BENCHMARK, COMPARE, RECALIBRATE, CARD = "planning", "compare", "recalibrate", "card"
SHIPPED_FOLDER = Path(__file__).parents[2] / "inference_api" / "pretrained"


def main(arguments: Sequence[str] | None = None, environment: Mapping[str, str] = os.environ) -> int:
    """Parse, evaluate, print; returns the exit code."""
    given = list(sys.argv[1:] if arguments is None else arguments)
    if given[:1] == [BENCHMARK]:
        return planning_benchmark(given[1:], environment)
    if given[:1] == [COMPARE]:
        return _compare(given[1:], environment)
    if given[:1] == [RECALIBRATE]:
        return recalibrate.main(given[1:], environment)
    if given[:1] == [CARD]:
        return _card(given[1:], environment)
    options = _parser().parse_args(given)
    try:
        request = make_request(
            options.model,
            budget=options.budget,
            scenarios=options.scenarios,
            seed=options.seed,
            promote=not options.no_promote,
            data=options.data,
            shipped=None if options.without_shipped else _shipped(environment),
        )
        uri = _tracking_uri(environment)
        tracking, registry = Tracking(uri), ModelRegistry(uri)
        show = partial(print, flush=True)
        outcome = evaluate_version(request, tracking, registry, executor(environment), show)
    except CspaceError as error:
        return report_error(error, ConfigError, ModelNotFoundError)
    _print(outcome)
    report_result(result(outcome), _rows(outcome), _folder(environment, outcome.run_id))
    return 0


def _compare(arguments: Sequence[str], environment: Mapping[str, str]) -> int:
    options = compare.make_parser().parse_args(arguments)
    try:
        uri = _tracking_uri(environment)
        runs, registry = Tracking(uri), ModelRegistry(uri)
        found = [compare.find(text, runs, registry) for text in options.what]
        print(aligned(compare.compare_table(found, everything=options.all)))
        if options.out is not None:
            compare.write_comparison(found, options.out, everything=options.all)
    except CspaceError as error:
        return report_error(error, InputError, ModelNotFoundError)
    return 0


def _card(arguments: Sequence[str], environment: Mapping[str, str]) -> int:
    options = model_card.make_parser().parse_args(arguments)
    try:
        uri = _tracking_uri(environment)
        model = ModelReference.parse(options.model)
        card = model_card.make_card(model, ModelRegistry(uri), Tracking(uri))
        if options.out is None:
            print(card, end="")
        else:
            model_card.write_card(card, options.out)
    except CspaceError as error:
        return report_error(error, ConfigError, InputError, ModelNotFoundError)
    return 0


def result(outcome: Outcome) -> dict[str, object]:
    """What the file and the last line say, for programs."""
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
        "metrics": flat_metrics(outcome.evaluation),
        "figures": list(outcome.figures),
    }


def _shipped(environment: Mapping[str, str]) -> Path:
    return Path(environment.get("CSPACE_PRETRAINED_MODEL") or SHIPPED_FOLDER)


def _tracking_uri(environment: Mapping[str, str]) -> str:
    uri = environment.get("MLFLOW_TRACKING_URI", "")
    if not uri:
        raise ConfigError("no tracking server is named", remedy="set MLFLOW_TRACKING_URI")
    return uri


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="python -m services.evaluator",
        description="Evaluate a version on scenarios it was never trained on; promote it if the gate holds.",
        epilog=f"`python -m services.evaluator {BENCHMARK} --help` describes the planning benchmark, "
        f"`{COMPARE} --help` of versions side by side, `{RECALIBRATE} --help` of confidence by outcomes, "
        f"`{CARD} --help` of model cards. "
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


def _print(outcome: Outcome) -> None:
    print(f"\n{scenes_text(outcome.evaluation.setting)}")
    print(f"\n{terminal_table(outcome.evaluation, outcome.verdict.bar.comparisons)}\n")
    moved = "promoted" if outcome.verdict.promoted else "not promoted"
    print(f"{moved}{'' if outcome.recorded else ' (evaluated only, nothing recorded)'}:")
    for reason in outcome.verdict.reasons:
        print(f"  {reason}")


def _rows(outcome: Outcome) -> dict[str, str]:
    version, promoted = outcome.version, outcome.verdict.promoted and outcome.recorded
    return {
        "model": f"{version}, digest {version.digest[:12]}",
        "promoted": "yes, it is the champion" if promoted else "no",
        "run": outcome.run_id,
        "report": f"{REPORT_FOLDER}/evaluation.md among the run's artifacts",
    }


def _folder(environment: Mapping[str, str], run_id: str) -> Path | None:
    """Of the evaluation among the jobs; None where no data folder is named."""
    data = Path(environment.get("CSPACE_DATA_DIR", ""))
    return data / "jobs" / run_id if data.is_absolute() else None


if __name__ == "__main__":
    sys.exit(main())
