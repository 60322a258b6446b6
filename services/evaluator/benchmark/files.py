"""Writes a benchmark: Parquet table, report, figures and pages in a folder, and metrics in a run."""

import math
import re
import shutil
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from matplotlib.figure import Figure

from cspace.errors import StorageError
from services.evaluator.benchmark.figures import all_figures
from services.evaluator.benchmark.report import comparison_note, report
from services.evaluator.benchmark.results import Convergence, Results
from services.evaluator.benchmark.store import MANIFEST, Run, RunStore, write_parquet
from services.evaluator.benchmark.summary import ArmSummary, Ratios
from services.evaluator.statistics import Interval
from services.names import EXPERIMENT
from services.registry.tracking.experiment import NOTE, TAG_STAGE
from services.registry.tracking.port import ID, Tracking


def flat_metrics(results: Results) -> dict[str, float]:
    """Family, arm and measure, as in ``narrow/RRT_way_70/iterations_ratio_median``; finite ones alone.

    Intervals end in ``_low`` and ``_high``. A break-even cost is in us; it lacks where there is none.
    """
    found: dict[str, float] = {}
    for family, result in results.families.items():
        for one in result.summaries:
            found |= {f"{family}/{metric_name(one.arm.name)}/{name}": value for name, value in _arm(one)}
        for way in result.convergence:
            found |= {f"{family}/{metric_name(way.arm.name)}/{name}": value for name, value in _way(way)}
    return {name: value for name, value in found.items() if math.isfinite(value)}


def run_metrics(results: Results) -> dict[str, float]:
    """Of every family and arm what is compared first; all the rest stands in the table of arms."""
    names = ("solved", "iterations_median", "edge_checks_median", "iterations_ratio_median")
    return {name: value for name, value in flat_metrics(results).items() if name.endswith(names)}


def arm_columns(results: Results) -> dict[str, list[Any]]:
    """Every number of :func:`flat_metrics`, one row each: family, arm, measure, value and limits."""
    found = flat_metrics(results)
    limits = ("_low", "_high")
    told = {name: value for name, value in found.items() if not name.endswith(limits)}
    places = [name.split("/") for name in told]
    return {
        "family": [place[0] for place in places],
        "arm": [place[1] for place in places],
        "measure": [place[2] for place in places],
        "value": list(told.values()),
        **{limit[1:]: [found.get(name + limit) for name in told] for limit in limits},
    }


def metric_name(arm: str) -> str:
    """An arm's name as a part of a metric's."""
    return re.sub(r"[^A-Za-z0-9.-]+", "_", arm.replace("*", "star")).strip("_")


def _arm(one: ArmSummary) -> Iterator[tuple[str, float]]:
    yield from _interval("solved", one.solved)
    yield from _interval("within_1000", one.within)
    for name in ("iterations", "edge_checks", "solve_ms", "total_ms"):
        summary = getattr(one, name)
        yield from ((f"{name}_median", summary.median), (f"{name}_p90", summary.p90))
    yield from ((f"{name}_ms_median", value[0]) for name, value in one.parts_ms.items())
    yield from _ratios("iterations_ratio", one.iteration_ratios)
    yield from _ratios("edge_checks_ratio", one.check_ratios)
    yield from _ratios("iterations_ratio_own_best", one.own_best_ratios)
    if one.length_ratio is not None:
        yield from _interval("length_ratio", one.length_ratio)
    if one.worth is not None:
        for name in ("edge_base", "edge_best", "state_base", "state_best"):
            found = getattr(one.worth, name)
            yield f"break_even_{name}_us", 1e6 * found.costs.low_s
            yield f"break_even_{name}_us_low", 1e6 * found.low_s[0]
            yield f"break_even_{name}_us_high", 1e6 * found.low_s[1]


def _way(one: Convergence) -> Iterator[tuple[str, float]]:
    yield from _interval("close", one.close)
    yield from (
        ("close_iterations_median", one.iterations.median),
        ("close_iterations_p90", one.iterations.p90),
    )
    yield from _ratios("close_iterations_ratio", one.iteration_ratios)
    yield "final_excess", one.final_excess


def _ratios(name: str, ratios: Ratios | None) -> Iterator[tuple[str, float]]:
    if ratios is not None:
        yield from _interval(f"{name}_median", ratios.median)
        yield from _interval(f"{name}_p90", ratios.p90)


def _interval(name: str, interval: Interval) -> Iterator[tuple[str, float]]:
    yield from ((name, interval.estimate), (f"{name}_low", interval.low), (f"{name}_high", interval.high))


PARQUET, REPORT, COMPARISON = "runs.parquet", "report.md", "comparison.md"
FIGURES, PAGES = "figures", "pages"
STAGE = "planning-benchmark"


def write_files(results: Results, store: RunStore[Run], pages: Iterable[tuple[str, Figure]]) -> None:
    """Writes the table, figures, pages, and the report that shows them.

    Args:
        results: of the benchmark.
        store: of its runs; the files go into its folder.
        pages: of problems, by name.

    Raises:
        StorageError: a file can not be written.
    """
    out = store.folder
    try:
        write_parquet(results.runs(), out / PARQUET)
        shown = [f"{FIGURES}/{name}" for name in _save_all(all_figures(results), out / FIGURES)]
        drawn = [f"{PAGES}/{name}" for name in _save_all(pages, out / PAGES)]
        (out / REPORT).write_text(report(results, store.manifest(), shown, drawn), "utf-8")
        (out / COMPARISON).write_text(comparison_note(results), "utf-8")
    except OSError as error:
        raise StorageError(f"the folder {out} can not be written", got=str(error)) from error


def log_run(tracking: Tracking, results: Results, store: RunStore[Run]) -> str:
    """Settings, metrics and files as a tracking run; its id.

    Args:
        tracking: where the run goes.
        results: of the benchmark.
        store: whose folder holds the files.

    Raises:
        RegistryError: the server refuses or does not answer.
    """
    manifest, setting = store.manifest(), results.setting
    name = f"planning, {setting.protocol}, {', '.join(results.families)}, seed {setting.seed}, {ID}"
    tags = {"protocol": setting.protocol.value, TAG_STAGE: STAGE}
    with tracking.start(EXPERIMENT, name, tags=tags) as run:
        samplers = {name: one["digest"] for name, one in manifest["samplers"].items()}
        run.params({"setting": asdict(results.setting), "samplers": samplers})
        run.metrics(run_metrics(results), 0)
        run.table(arm_columns(results), "arms")
        run.tags({NOTE: comparison_note(results)})
        for part in (MANIFEST, PARQUET, REPORT, COMPARISON):
            run.artifact(store.folder / part)
        for path in sorted((store.folder / FIGURES).glob("*.png")):
            run.figure(Saved(path), path.stem)
        if (store.folder / PAGES).is_dir():
            run.artifact(store.folder / PAGES, PAGES)
        run.flush()
        return run.run_id


@dataclass(frozen=True, slots=True)
class Saved:
    """A picture that was drawn before."""

    path: Path

    def savefig(self, fname: Path, *, format: str) -> None:  # noqa: A002, ARG002 - matplotlib's own names
        """Copy it; it is a PNG file whatever is asked for."""
        shutil.copyfile(self.path, fname)


def _save_all(figures: Iterable[tuple[str, Figure]], folder: Path) -> Sequence[str]:
    names = []
    for name, figure in figures:
        folder.mkdir(exist_ok=True)
        figure.savefig(folder / f"{name}.png")
        names.append(f"{name}.png")
    return names
