"""What a benchmark leaves behind: table, logs, report, figures and pages in a folder, and all in a run."""

from collections.abc import Iterable, Sequence
from dataclasses import asdict
from importlib.metadata import version
from pathlib import Path

from matplotlib.figure import Figure

from cspace.errors import StorageError
from services.evaluator.benchmark.runs.store import MANIFEST, RunStore
from services.evaluator.benchmark.summary.results import Results
from services.evaluator.benchmark.telling.figures import all_figures
from services.evaluator.benchmark.telling.frame import write_parquet
from services.evaluator.benchmark.telling.metrics import flat_metrics
from services.evaluator.benchmark.telling.ompl_log import ompl_log
from services.evaluator.benchmark.telling.report import report
from services.names import EXPERIMENT
from services.registry.tracking.port import Tracking

PARQUET, REPORT, FIGURES, PAGES = "runs.parquet", "report.md", "figures", "pages"
RUN_NAME = "planning-benchmark"


def write_files(results: Results, store: RunStore, pages: Iterable[tuple[str, Figure]]) -> None:
    """Table, a log a family, figures, pages, and the report that shows them.

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
        for family, found in results.families.items():
            (out / log_name(family)).write_text(ompl_log(found, results, version("ompl")), "utf-8")
        shown = [f"{FIGURES}/{name}" for name in _save_all(all_figures(results), out / FIGURES)]
        drawn = [f"{PAGES}/{name}" for name in _save_all(pages, out / PAGES)]
        (out / REPORT).write_text(report(results, store.manifest(), shown, drawn), "utf-8")
    except OSError as error:
        raise StorageError(f"the folder {out} can not be written", got=str(error)) from error


def log_run(tracking: Tracking, results: Results, store: RunStore) -> str:
    """Settings, metrics and files as a tracking run; its id.

    Args:
        tracking: where the run goes.
        results: of the benchmark.
        store: whose folder holds the files.

    Raises:
        RegistryError: the server refuses or does not answer.
    """
    manifest = store.manifest()
    with tracking.start(EXPERIMENT, RUN_NAME, tags={"protocol": results.setting.protocol.value}) as run:
        samplers = {name: one["digest"] for name, one in manifest["samplers"].items()}
        run.params({"setting": asdict(results.setting), "samplers": samplers})
        run.metrics(flat_metrics(results), 0)
        for name in (MANIFEST, PARQUET, REPORT, *map(log_name, results.families)):
            run.artifact(store.folder / name)
        for name in (FIGURES, PAGES):
            if (store.folder / name).is_dir():
                run.artifact(store.folder / name, name)
        run.flush()
        return run.run_id


def log_name(family: str) -> str:
    """Of a family's log in OMPL's format."""
    return f"{family}.log"


def _save_all(figures: Iterable[tuple[str, Figure]], folder: Path) -> Sequence[str]:
    names = []
    for name, figure in figures:
        folder.mkdir(exist_ok=True)
        figure.savefig(folder / f"{name}.png")
        names.append(f"{name}.png")
    return names
