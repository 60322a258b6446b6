"""What a study measures: at every snapshot on validation scenarios, at the end on seen and unseen ones.

Every measurement is kept as a file, so that a stopped study measures nothing twice.
"""

import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from benchmarks.paper.columns import BASE, Column
from benchmarks.paper.jobs import Study
from cspace.bundle import Bundle
from cspace.dataset import Dataset, open_dataset
from cspace.errors import EvaluationError
from cspace.simulator import Split
from services.evaluator.evaluation import estimates_of
from services.evaluator.measure import measure_topology, reconstruct
from services.evaluator.metrics import Task
from services.evaluator.metrics.geometry_score import POINTS
from services.evaluator.scenes import Scene, Stage
from services.evaluator.statistics import Interval
from services.evaluator.tables import Table
from services.planner.samples import BundleSampler
from training.clusters.bundling import TrainedParts, make_bundle
from training.config import TrainConfig
from training.models.checkpoint import read_progress
from training.trials.arrays import TrainingArrays

Measured = dict[str, Any]
MEASURES = ("precision", "coverage", "edr")
SCORE = "gsc_boundary"


@dataclass(frozen=True, slots=True)
class Effort:
    """How much is measured.

    Args:
        scenarios: for the table, seen and unseen each.
        validation: for each snapshot.
        topology: for GS-C, seen and unseen each.
        draws: of landmarks per cloud and turn.
        samples: per scenario.
        topology_samples: points per cloud for GS-C.
    """

    scenarios: int = 100
    validation: int = 25
    topology: int = 8
    draws: int = 50
    samples: int = 1000
    topology_samples: int = POINTS


def dataset_of(study: Study, column: Column) -> Dataset:
    """The data set that all columns were trained on."""
    return open_dataset(study.data / "datasets" / study.scale.config(column, None).data.folder_name)


def bundles(study: Study, column: Column, dataset: Dataset) -> dict[int, Bundle]:
    """Bundle by generator step, from each of the column's snapshots; the last is the registered one."""
    folder, config = study.job_folder(column), study.scale.config(column, None)
    if folder is None:
        raise EvaluationError("the column is not trained", got=column.name)
    made: dict[int, Bundle] = {}
    for step, checkpoint in sorted(study.checkpoints(column, "global").items()):
        target = study.out / "bundles" / f"{column.name}-{step}"
        if step == config.global_.steps:
            target = folder / "bundle"
        elif not target.exists():
            encoder = checkpoint if config.joint else study.encoder()
            if encoder is None:
                raise EvaluationError("the shared encoder is not trained", got=BASE.name)
            parts = TrainedParts(encoder, (checkpoint,), None, None, plain_arrays(config, dataset))
            make_bundle(target, config, dataset, parts)
        made[step] = Bundle.load(target)
    return made


def plain_arrays(config: TrainConfig, dataset: Dataset) -> TrainingArrays:
    """What an export needs of the training's arrays: the data, without clusters and with empty latents."""
    count = dataset.scenario_count
    free, ids = np.asarray(dataset.free), np.repeat(np.arange(count), np.diff(dataset.free_offsets))
    return TrainingArrays.unencoded(dataset, free, ids, 0 * ids, config.vae.latent_dim)


def learning_curve(study: Study, column: Column, made: Mapping[int, Bundle], effort: Effort) -> Measured:
    """Losses by step, and quality on validation scenarios by snapshot."""
    last = max(study.checkpoints(column, "global").items())[1]
    stage = _stage(next(iter(made.values())), Split.VALIDATION, 0)
    rows = []
    for step, bundle in made.items():
        name = f"{column.name}-{step}-validation-{effort.validation}"
        summary = _kept(study, name, bundle, lambda b: quality(stage, b, effort.validation, effort.samples))
        rows.append({"step": step, **summary["sampler"]})
    return {"losses": [dict(row) for row in read_progress(last).history], "quality": rows}


def final_quality(study: Study, column: Column, bundle: Bundle, seed: int, effort: Effort) -> Measured:
    """Precision, coverage, EDr and GS-C on the training's scenarios and on unseen test scenarios.

    Args:
        study: whose column.
        column: which one.
        bundle: its last.
        seed: of the training's scenarios.
        effort: how much.
    """
    found: Measured = {}
    for name, split, of in (("seen", Split.TRAIN, seed), ("unseen", Split.TEST, 0)):
        stage = _stage(bundle, split, of)
        found[name] = _kept(
            study,
            f"{column.name}-{name}-{effort.scenarios}",
            bundle,
            lambda b, stage=stage: quality(stage, b, effort.scenarios, effort.samples),
        )
        found[f"{name}_topology"] = _kept(
            study,
            f"{column.name}-{name}-topology-{effort.topology}-{effort.draws}",
            bundle,
            lambda b, stage=stage: _topology(stage, b, effort),
        )
    return found


def table(columns: Sequence[Column], found: Mapping[str, Measured]) -> Table:
    """One row a column and split, then uniform and real samples."""
    rows = [["column", "scenarios", "precision", "coverage", "EDr", "GS-C x 1e4 (noise floor)"]]
    for split in ("seen", "unseen"):
        for column in columns:
            one = found[column.name]
            rows.append(
                [column.label, split, *_cells(one[split]["sampler"]), _score(one[f"{split}_topology"])]
            )
        any_column = found[columns[0].name][split]
        rows += [[name, split, *_cells(any_column[name]), ""] for name in ("uniform", "real")]
    return rows


def _stage(bundle: Bundle, split: Split, seed: int) -> Stage:
    return Stage(bundle.spec.world, split, seed)


def quality(stage: Stage, bundle: Bundle, scenarios: int, samples: int) -> Measured:
    """Estimates of a bundle's, of uniform and of real samples, by measure."""
    sampler = BundleSampler(bundle)
    rows = [row for index in range(scenarios) for row in reconstruct(Scene(stage, index), sampler, samples)]
    found = estimates_of(rows, stage.seed)
    return {
        name: {key: found[name, key].to_dict() for key in MEASURES} for name in ("sampler", "uniform", "real")
    }


def _topology(stage: Stage, bundle: Bundle, effort: Effort) -> Measured:
    scenes = [Scene(stage, index) for index in range(effort.topology)]
    sampler = BundleSampler(bundle)
    rows = [
        row
        for scene in scenes
        for row in measure_topology(scene, sampler, effort.draws, effort.topology_samples)
    ]
    found = estimates_of(rows, stage.seed, Task.TOPOLOGY)
    return {"score": found["", SCORE].to_dict(), "floor": found["", f"{SCORE}_floor"].to_dict()}


def _kept(study: Study, name: str, bundle: Bundle, measure: Callable[[Bundle], Measured]) -> Measured:
    """A measurement of this very bundle from its file, or made and written there."""
    path = study.out / "measures" / f"{name}.json"
    if path.is_file():
        record: Measured = json.loads(path.read_text(encoding="utf-8"))
        if record["digest"] == bundle.digest:
            measured: Measured = record["measured"]
            return measured
    found = measure(bundle)
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(json.dumps({"digest": bundle.digest, "measured": found}), encoding="utf-8")
    return found


def _cells(measured: Measured) -> list[str]:
    return [f"{_interval(measured[name]):.3f}" for name in MEASURES]


def _score(measured: Measured) -> str:
    score, floor = (_interval(measured[name]).scaled(1e4) for name in ("score", "floor"))
    return f"{score:.1f} ({floor.estimate:.1f})"


def _interval(values: Measured) -> Interval:
    return Interval(**values)
