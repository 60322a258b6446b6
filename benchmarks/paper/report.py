"""What a study leaves behind: the columns' bundles, two pictures, and the table as Markdown and JSON."""

import dataclasses
import json
import shutil
from collections.abc import Callable, Sequence
from typing import Any

from benchmarks.paper.columns import BASE, Column
from benchmarks.paper.figures import convergence, reconstruction, typical
from benchmarks.paper.jobs import Study
from benchmarks.paper.measures import (
    MEASURES,
    Effort,
    bundles,
    dataset_of,
    final_quality,
    learning_curve,
    quality,
    table,
)
from cspace.bundle import Bundle
from cspace.errors import EvaluationError
from cspace.simulator import Split
from services.evaluator.scenes import Stage
from services.evaluator.tables import markdown
from services.planner.samples import BundleSampler

# Enough for a caption; the table's scores stand on several scenarios.
CAPTION_DRAWS = 50


def compare_columns(
    study: Study, columns: Sequence[Column], effort: Effort, say: Callable[[str], None] = print
) -> None:
    """Measure every column that is trained and write the report into the study's folder.

    Raises:
        EvaluationError: no column is trained.
    """
    trained = [column for column in columns if study.result(column) is not None]
    if not trained:
        raise EvaluationError("no column is trained yet", got=str(study.out))
    dataset = dataset_of(study, BASE)
    seed = dataset.generator_seed or 0
    curves, found, last = {}, {}, {}
    for column in trained:
        say(f"judging: {column.label}")
        made = bundles(study, column, dataset)
        curves[column.label] = learning_curve(study, column, made, effort)
        last[column] = made[max(made)]
        found[column.name] = final_quality(study, column, last[column], seed, effort)
    stage = Stage(dataset.world, Split.VALIDATION, 0)
    uniform = quality(stage, last[trained[0]], effort.validation, effort.samples)["uniform"]
    floor = {name: uniform[name]["estimate"] for name in MEASURES}
    convergence(curves, floor).savefig(study.out / "convergence.png", dpi=100)
    _draw_reconstruction(study, last, seed)
    for column, bundle in last.items():
        target = study.out / "bundles" / column.name
        shutil.copytree(bundle.folder, target, dirs_exist_ok=True)
    text = markdown(table(trained, found))
    (study.out / "table.md").write_text(text + "\n", encoding="utf-8")
    record = {
        "trained": {column.name: _training(study, column, last[column]) for column in trained},
        "scale": dataclasses.asdict(study.scale),
        "effort": dataclasses.asdict(effort),
        "curves": curves,
        "columns": found,
    }
    (study.out / "report.json").write_text(json.dumps(record, indent=1), encoding="utf-8")
    say(text)


def _training(study: Study, column: Column, bundle: Bundle) -> dict[str, Any]:
    """Where a column's bundle comes from, and how long its trials took."""
    result, source = study.result(column) or {}, bundle.spec.provenance
    return {
        "label": column.label,
        "digest": bundle.digest,
        "data": source.data_digest,
        "commit": source.git_commit,
        "dirty": source.git_dirty,
        "seconds": {name: end - start for name, (start, end) in result.get("trials", {}).items()},
    }


def _draw_reconstruction(study: Study, last: dict[Column, Bundle], seed: int) -> None:
    spec = next(iter(last.values())).spec
    scenes = [typical(Stage(spec.world, split, of)) for split, of in ((Split.TRAIN, seed), (Split.DEMO, 0))]
    samplers = {column.label: BundleSampler(bundle) for column, bundle in last.items()}
    reconstruction(scenes, samplers, CAPTION_DRAWS).savefig(study.out / "reconstruction.png", dpi=100)
