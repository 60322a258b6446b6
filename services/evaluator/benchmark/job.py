"""The benchmark from its samplers to its files: find what is missing, run it, keep it, tell it."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from cspace.problem import Family
from services.evaluator.benchmark.arms import Arm
from services.evaluator.benchmark.frame import write_parquet
from services.evaluator.benchmark.progress import Progress
from services.evaluator.benchmark.report import report
from services.evaluator.benchmark.results import Results
from services.evaluator.benchmark.runs import Run
from services.evaluator.benchmark.setting import Setting, units
from services.evaluator.benchmark.sources import SourceSpec
from services.evaluator.benchmark.spread import Execute
from services.evaluator.benchmark.store import RunStore

PARQUET, REPORT = "runs.parquet", "report.md"
Show = Callable[[str], None]


@dataclass(frozen=True)
class Request:
    """What a benchmark is asked for.

    Args:
        out: folder of runs and report.
        setting: the limits.
        families: of problems.
        problems: of each family.
        repeats: runs of each problem.
        arms: that are compared.
        specs: the learned samplers of the arms.
    """

    out: Path
    setting: Setting
    families: tuple[Family, ...]
    problems: int
    repeats: int
    arms: tuple[Arm, ...]
    specs: tuple[SourceSpec, ...]

    def covers(self, run: Run) -> bool:
        """Whether a run is among those asked for; the folder may hold others of the same setting."""
        return (
            run.family in {family.value for family in self.families}
            and run.arm in {arm.name for arm in self.arms}
            and run.problem < self.problems
            and run.run < self.repeats
        )


def run_benchmark(request: Request, execute: Execute, show: Show) -> Results:
    """Run what is missing, then write table and report over all that was asked for.

    Args:
        request: what is asked for.
        execute: in processes, or over a cluster; the numbers are the same, times apart.
        show: takes lines for people.

    Raises:
        ConfigError: the folder holds runs of another setting.
        CspaceError: a run failed; those before it are kept.
    """
    store = RunStore.open(request.out, request.setting, request.arms, request.specs)
    work = list(units(request.families, request.problems, request.repeats, request.arms, store.done()))
    show(f"{len(request.arms)} arms; {len(work)} runs of problems to do")
    with Progress("planning", len(work), show) as progress:
        for found in execute(work, request.setting, request.specs) if work else ():
            store.append(found)
            progress.advance()
    runs = [run for run in store.runs() if request.covers(run)]
    results = Results.gather(runs, request.families, request.arms, request.setting)
    write_parquet(runs, request.out / PARQUET)
    (request.out / REPORT).write_text(report(results, store.manifest()), "utf-8")
    return results
