"""The benchmark of plans from its models to its files: find what is missing, run it, keep it, tell it."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path

from cspace.errors import EvaluationError
from services.evaluator.benchmark.plans.files import log_plan_run, write_plan_files
from services.evaluator.benchmark.plans.record import PlanRun
from services.evaluator.benchmark.plans.report import PlanResults
from services.evaluator.benchmark.plans.setting import PlanSetting, PlanUnit, arms_of, plan_units
from services.evaluator.benchmark.runs.sources import SourceSpec
from services.evaluator.benchmark.runs.spread import Executes
from services.evaluator.benchmark.runs.store import RunStore
from services.progress import Progress
from services.registry.tracking.port import Tracking

PlanExecute = Executes[PlanUnit, PlanSetting, PlanRun]


@dataclass(frozen=True)
class PlanRequest:
    """What a benchmark of plans is asked for.

    Args:
        out: folder of runs and report.
        setting: the limits.
        problems: how many of each family.
        pictures: by how many each is seen, in turn.
        runs: with exact checks, of each problem.
        specs: the models that plan.
        folder: of problems that do not ship.
    """

    out: Path
    setting: PlanSetting
    problems: Mapping[str, int]
    pictures: tuple[int, ...]
    runs: int
    specs: tuple[SourceSpec, ...]
    folder: Path | None = None

    def covers(self, run: PlanRun) -> bool:
        """Whether a run is among those asked for; the folder may hold others of the same setting."""
        return (
            run.arm in {arm.name for arm in arms_of([spec.name for spec in self.specs])}
            and run.problem < self.problems.get(run.family, 0)
            and run.pictures in (0, *self.pictures)
            and run.run < self.runs
        )


def run_plans(
    request: PlanRequest,
    execute: PlanExecute,
    show: Callable[[str], None],
    tracking: Tracking | None = None,
) -> PlanResults:
    """Run what is missing, then tell of all that was asked for.

    Args:
        request: what is asked for.
        execute: in processes, or over a cluster; the numbers are the same, times apart.
        show: takes lines for people.
        tracking: where a run is logged; None for nowhere.

    Raises:
        ConfigError: the folder holds runs of another setting.
        CspaceError: a run failed; those before it are kept.
    """
    arms = arms_of([spec.name for spec in request.specs])
    store = RunStore.begin(request.out, PlanRun, request.setting, arms, request.specs)
    work = list(
        plan_units(request.problems, request.pictures, request.runs, arms, store.done(), request.folder)
    )
    show(f"{len(arms)} arms; {len(work)} views of problems to do")
    with Progress("planning", len(work), show) as progress:
        for found in execute(work, request.setting, request.specs) if work else ():
            store.append(found)
            progress.advance()
    runs = [run for run in store.runs() if request.covers(run)]
    results = PlanResults.gather(runs, request.pictures, request.setting)
    if not results.plans:
        raise EvaluationError("no problem was run by all arms", expected="one or more", got="none")
    write_plan_files(results, store)
    if tracking is not None:
        show(f"logged as run {log_plan_run(tracking, results, store)}")
    return results
