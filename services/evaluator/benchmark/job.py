"""The benchmark from its samplers to its files: find what is missing, run it, keep it, tell it."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path

from services.evaluator.benchmark.runs.arms import Arm
from services.evaluator.benchmark.runs.run import Run
from services.evaluator.benchmark.runs.setting import Setting, units
from services.evaluator.benchmark.runs.sources import SourceSpec
from services.evaluator.benchmark.runs.spread import Execute
from services.evaluator.benchmark.runs.store import RunStore
from services.evaluator.benchmark.summary.results import Results
from services.evaluator.benchmark.telling.files import log_run, write_files
from services.evaluator.benchmark.telling.pages import pages
from services.progress import Progress
from services.registry.tracking.port import Tracking

Show = Callable[[str], None]


@dataclass(frozen=True)
class Request:
    """What a benchmark is asked for.

    Args:
        out: folder of runs and report.
        setting: the limits.
        problems: how many of each family.
        repeats: runs of each problem.
        arms: that are compared.
        specs: the learned samplers of the arms.
        pages: of single problems that are drawn, of each family.
    """

    out: Path
    setting: Setting
    problems: Mapping[str, int]
    repeats: int
    arms: tuple[Arm, ...]
    specs: tuple[SourceSpec, ...]
    pages: int = 3

    def covers(self, run: Run) -> bool:
        """Whether a run is among those asked for; the folder may hold others of the same setting."""
        return (
            run.arm in {arm.name for arm in self.arms}
            and run.problem < self.problems.get(run.family, 0)
            and run.run < self.repeats
        )


def run_benchmark(
    request: Request, execute: Execute, show: Show, tracking: Tracking | None = None
) -> Results:
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
    store = RunStore.open(request.out, request.setting, request.arms, request.specs)
    work = list(
        units(request.problems, request.repeats, request.arms, store.done(), request.setting.families)
    )
    show(f"{len(request.arms)} arms; {len(work)} runs of problems to do")
    with Progress("planning", len(work), show) as progress:
        for found in execute(work, request.setting, request.specs) if work else ():
            store.append(found)
            progress.advance()
    runs = [run for run in store.runs() if request.covers(run)]
    results = Results.gather(runs, list(request.problems), request.arms, request.setting)
    shown = {family: min(request.pages, count) for family, count in request.problems.items()}
    write_files(results, store, pages(shown, request.arms, request.setting, request.specs))
    if tracking is not None:
        show(f"logged as run {log_run(tracking, results, store)}")
    return results
