"""The planning benchmark: ``python -m services.evaluator planning --out FOLDER --bundle NAME=FOLDER``."""

import os
import sys
from collections.abc import Mapping, Sequence

from cspace.errors import ConfigError, CspaceError
from services.command_errors import tell_error
from services.evaluator.benchmark.arms import Protocol
from services.evaluator.benchmark.execution import executor, executor_of
from services.evaluator.benchmark.files import REPORT
from services.evaluator.benchmark.job import chosen_arms, make_request, parser, run_benchmark
from services.evaluator.benchmark.plans.job import make_plan_request, refuse_others, run_plans
from services.evaluator.benchmark.plans.measure import PlanWorker
from services.evaluator.benchmark.plans.report import plan_terminal
from services.evaluator.benchmark.report import terminal_tables
from services.registry.tracking.port import Tracking


def main(arguments: Sequence[str] | None = None, environment: Mapping[str, str] = os.environ) -> int:
    """Parse, run, print; returns the exit code."""
    known = parser()
    options = known.parse_args(arguments)
    try:
        refuse_others(options, known)
        if options.list_arms:
            print("\n".join(f"{arm.group:11} {arm.name}" for arm in chosen_arms(options)))
            return 0
        tracking = None if options.no_mlflow else _tracking(environment)
        if options.protocol is Protocol.PLANS:
            asked = make_plan_request(options)
            execute = executor_of(PlanWorker, environment, options.processes)
            told = plan_terminal(run_plans(asked, execute, _show, tracking))
        else:
            request = make_request(options)
            results = run_benchmark(request, executor(environment, options.processes), _show, tracking)
            told = terminal_tables(results)
    except CspaceError as error:
        return tell_error(error, ConfigError)
    print(told)
    print(f"{options.out / REPORT}", flush=True)
    return 0


def _tracking(environment: Mapping[str, str]) -> Tracking:
    uri = environment.get("MLFLOW_TRACKING_URI", "")
    if not uri:
        raise ConfigError(
            "no tracking server is named", remedy="set MLFLOW_TRACKING_URI, or give --no-mlflow"
        )
    # MLflow takes seconds to import.
    from services.registry.tracking.mlflow_tracking import MlflowTracking  # noqa: PLC0415

    return MlflowTracking(uri)


def _show(line: str) -> None:
    print(line, flush=True)


if __name__ == "__main__":
    sys.exit(main())
