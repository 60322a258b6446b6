"""The job of a benchmark: run what is missing, summarise, write table, report and figures, log them."""

import shutil
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.figure import Figure

from cspace.errors import StorageError
from services.evaluator.benchmark import report
from services.evaluator.benchmark.arms import Protocol, Setting, Unit
from services.evaluator.benchmark.execution import Execute
from services.evaluator.benchmark.figures import pages, safety_figure, sample_figures
from services.evaluator.benchmark.plans import plan_units
from services.evaluator.benchmark.runs import MANIFEST, RunStore
from services.evaluator.benchmark.samples import sample_units
from services.evaluator.benchmark.sources import SourceSpec
from services.evaluator.benchmark.summary import metric_name, metrics, summarise_plans, summarise_samples
from services.evaluator.tables import markdown
from services.names import EXPERIMENT, NOTE, TAG_STAGE
from services.progress import Progress
from services.registry.entities import ID
from services.registry.tracking import RunLog, Tracking

Show = Callable[[str], None]
PARQUET, REPORT, COMPARISON = "runs.parquet", "report.md", "comparison.md"
FIGURES, PAGES = "figures", "pages"
STAGE = "planning-benchmark"
# The measures that become metrics of the tracking run; the table of arms holds all of them.
METRICS = (
    "solved", "iterations_median", "close_iterations_median", "edge_checks_median",
    "close_edge_checks_median", "iterations_ratio_median", "close_iterations_ratio_median", "collide", "more",
    "calibration_error", "surer_half_collide", "states_ratio_median", "states_ratio_p90",
)  # fmt: skip


@dataclass(frozen=True)
class Request:
    """What a benchmark runs.

    Args:
        out: folder of runs and report.
        setting: of all runs.
        problems: number of each family.
        repeats: runs of each problem; of protocol ``plans`` those with exact checks.
        arms: that are compared.
        specs: the models of the arms.
        pages: number of single problems that are plotted, of each family.
        pictures: of protocol ``plans``, by which each problem is seen.
        folder: of problems that do not ship.
    """

    out: Path
    setting: Setting
    problems: Mapping[str, int]
    repeats: int
    arms: tuple[Any, ...]
    specs: tuple[SourceSpec, ...]
    pages: int = 3
    pictures: tuple[int, ...] = ()
    folder: Path | None = None

    def units(self) -> Iterable[Unit]:
        """Everything that is run."""
        if self.setting.protocol is Protocol.PLANS:
            return plan_units(self.problems, self.pictures, self.repeats, self.arms, self.folder)
        return sample_units(self.setting, self.problems, self.repeats, self.arms)


@dataclass(frozen=True)
class Results:
    """A finished benchmark: its runs, one row each, their summary, and the report's first line and tables."""

    request: Request
    runs: pd.DataFrame
    summary: pd.DataFrame
    headline: str
    sections: tuple[report.Section, ...]

    @classmethod
    def of(cls, request: Request, runs: pd.DataFrame) -> "Results":
        """Summarise the runs.

        Raises:
            EvaluationError: no problem was run by all arms.
        """
        setting, arms = request.setting, request.arms
        if setting.protocol is Protocol.PLANS:
            summary = summarise_plans(runs, request.pictures, arms, setting)
            headline = report.collision_line(summary, request.pictures, arms, setting)
            sections = report.plan_sections(summary, runs, request.pictures, arms, setting)
        else:
            summary = summarise_samples(runs, request.problems, arms, setting)
            headline = report.break_even_line(summary, arms, setting)
            sections = report.sample_sections(summary, arms, setting)
        return cls(request, runs, summary, headline, tuple(sections))

    @property
    def note(self) -> str:
        """The short form: the headline, and the tables of work."""
        work = [markdown(table) for heading, _, table in self.sections if heading.startswith("Work")]
        return "\n\n".join([self.headline, *work]) + "\n"

    def figures(self) -> Iterable[tuple[str, Figure]]:
        """Every figure with its name."""
        setting, arms = self.request.setting, self.request.arms
        if setting.protocol is Protocol.PLANS:
            return [("safety", safety_figure(self.runs, self.request.pictures, arms, setting))]
        return sample_figures(self.runs, list(self.request.problems), arms, setting)

    def terminal(self) -> str:
        """The tables for a terminal."""
        return report.terminal(self.headline, self.sections)


def run_benchmark(
    request: Request, execute: Execute, show: Show, tracking: Tracking | None = None
) -> Results:
    """Run what is missing, report on the whole request, and log it where there is a tracking server.

    Raises:
        ConfigError: the folder holds runs of another setting.
        EvaluationError: no problem was run by all arms.
        CspaceError: a run failed; those before it are kept.
    """
    store = RunStore(request.out, request.setting, request.arms, request.specs)
    units = list(request.units())
    done = store.keys()
    work = [left for unit in units if (left := unit.without(done)).todo]
    what = "views of problems" if request.pictures else "runs of problems"
    show(f"{len(request.arms)} arms; {len(work)} {what} to do")
    with Progress("planning", len(work), show) as progress:
        for found in execute(work, request.setting, request.specs) if work else ():
            store.append(found)
            progress.advance()
    results = Results.of(request, store.frame(key for unit in units for key in unit.run_keys()))
    _write(results, store)
    if tracking is not None:
        show(f"logged as run {_log(tracking, results, store)}")
    return results


def _write(results: Results, store: RunStore) -> None:
    """Write the table, figures, pages, and the report that shows them."""
    out, request = store.folder, results.request
    plotted = {family: min(request.pages, count) for family, count in request.problems.items()}
    try:
        results.runs.to_parquet(out / PARQUET, index=False)
        shown = _save(results.figures(), out, FIGURES)
        figures = []
        if request.setting.protocol is not Protocol.PLANS:
            figures = _save(pages(plotted, request.arms, request.setting, request.specs), out, PAGES)
            (out / COMPARISON).write_text(results.note, "utf-8")
        facts = report.about(results.runs, request.setting, store.manifest)
        text = report.report(
            results.headline, facts, results.sections, request.setting.protocol, shown, figures
        )
        (out / REPORT).write_text(text, "utf-8")
    except OSError as error:
        raise StorageError(f"the folder {out} can not be written", got=str(error)) from error


def _save(figures: Iterable[tuple[str, Figure]], out: Path, folder: str) -> list[str]:
    names = []
    for name, figure in figures:
        (out / folder).mkdir(exist_ok=True)
        names.append(f"{folder}/{name}.png")
        figure.savefig(out / names[-1])
    return names


def _log(tracking: Tracking, results: Results, store: RunStore) -> str:
    """Settings, metrics and files as a tracking run; its id."""
    setting, families = results.request.setting, ", ".join(results.request.problems)
    what = setting.split if setting.protocol is Protocol.PLANS else families
    name = f"planning, {setting.protocol}, {what}, seed {setting.seed}, {ID}"
    with tracking.start(EXPERIMENT, name, tags={"protocol": setting.protocol.value, TAG_STAGE: STAGE}) as run:
        samplers = {name: one["digest"] for name, one in store.manifest["samplers"].items()}
        run.params({"setting": asdict(setting), "samplers": samplers})
        run.metrics(metrics(results.summary, METRICS), 0)
        run.table(_columns(results.summary), "arms")
        run.tags({NOTE: results.note if setting.protocol is not Protocol.PLANS else results.headline})
        _log_files(run, store.folder)
        run.flush()
        return run.run_id


def _log_files(run: RunLog, folder: Path) -> None:
    for part in (MANIFEST, PARQUET, REPORT, COMPARISON):
        if (folder / part).is_file():
            run.artifact(folder / part)
    for path in sorted((folder / FIGURES).glob("*.png")):
        run.figure(_Saved(path), path.stem)
    if (folder / PAGES).is_dir():
        run.artifact(folder / PAGES, PAGES)


def _columns(summary: pd.DataFrame) -> dict[str, Sequence[Any]]:
    """The summary for the tracking run: finite numbers, metric names."""
    found = summary[np.isfinite(summary["value"])]
    limits = found[["low", "high"]]
    limits = limits.astype(object).where(np.isfinite(limits), None)
    return dict(found.assign(arm=found["arm"].map(metric_name), **limits).to_dict("list"))


@dataclass(frozen=True, slots=True)
class _Saved:
    """A picture that is a PNG file already."""

    path: Path

    def savefig(self, fname: Path, *, format: str) -> None:  # noqa: A002, ARG002 - matplotlib's own names
        """Copy it."""
        shutil.copyfile(self.path, fname)
