"""Writes a benchmark: table, report, figures and pages in a folder, and all in a run."""

import shutil
from collections.abc import Iterable, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

from matplotlib.figure import Figure

from cspace.errors import StorageError
from services.evaluator.benchmark.runs.run import Run
from services.evaluator.benchmark.runs.store import MANIFEST, RunStore
from services.evaluator.benchmark.summary.results import Results
from services.evaluator.benchmark.telling.figures import all_figures
from services.evaluator.benchmark.telling.frame import write_parquet
from services.evaluator.benchmark.telling.metrics import arm_columns, run_metrics
from services.evaluator.benchmark.telling.report import comparison_note, report
from services.names import EXPERIMENT
from services.registry.tracking.experiment import NOTE, TAG_STAGE
from services.registry.tracking.port import ID, Tracking

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
