"""The main job: data, VAE and validity head, clusters, local trials, global trial, bundle, registry."""

import logging
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cspace.bundle import Bundle
from cspace.dataset import Dataset, open_dataset
from services.registry.mlflow_registry import MlflowRegistry
from services.registry.mlflow_tracking import MlflowTracking
from services.registry.names import ALIAS_CHALLENGER, EXPERIMENT, MODEL_NAME
from services.registry.tracking import RunLog
from training.bundling import TrainedParts, load_gate, make_bundle
from training.clustering import cluster, group, points_in_cells
from training.config import TrainConfig
from training.datasets.generate import generate
from training.encode import encode, load_encoder
from training.environment import Environment
from training.models.gate import gate_probabilities
from training.provenance import source_state
from training.reporting import log_result, log_start
from training.trials.arrays import GatedCells, TrainingArrays
from training.trials.launch import TrialOutcome, connect, run_trials
from training.trials.occupancy import OccupancyArrays
from training.trials.trainables import (
    DISTILLED,
    GATE,
    GLOBAL,
    VAE,
    VALIDITY,
    distillation_trial,
    gate_trial,
    global_trial,
    local_trial,
    picture_trial,
)

_LOG = logging.getLogger("training")


@dataclass(frozen=True, slots=True)
class TrainResult:
    """What a job leaves behind.

    Args:
        run_id: the parent run.
        model: the registered model's name.
        version: the new version.
        digest: the bundle's digest.
        data_digest: the data set's digest.
        metrics: last metrics of the global trial.
        trials: start and end of every trial, Unix time by Tune's clock.
        figures: names of the pictures logged with the run.
    """

    run_id: str
    model: str
    version: int
    digest: str
    data_digest: str
    metrics: Mapping[str, float]
    trials: Mapping[str, tuple[float, float]]
    figures: tuple[str, ...]


@dataclass(frozen=True, slots=True)
class _Job:
    """A job under way: its configuration, its parent run and the folder of its trials."""

    config: TrainConfig
    environment: Environment
    tracking: MlflowTracking
    run: RunLog
    folder: Path

    def child(self, name: str) -> str:
        """A child run, made here so that a retried trial continues it."""
        return self.tracking.start(EXPERIMENT, name, parent_run_id=self.run.run_id).run_id

    def shared(self, arrays: TrainingArrays) -> dict[str, Any]:
        """What every trial on configurations gets."""
        return {"train": self.config, "arrays": arrays, "tracking_uri": self.environment.tracking_uri}


def train(config: TrainConfig, environment: Environment) -> TrainResult:
    """Run the whole job.

    Raises:
        CspaceError: bad data, a failed trial, or a registry that does not answer.
    """
    connect()
    dataset = prepare_data(config, environment.data_folder)
    tracking = MlflowTracking(environment.tracking_uri)
    with tracking.start(EXPERIMENT, "cluster-train", tags=_tags(config)) as run:
        job = _Job(config, environment, tracking, run, environment.data_folder / "jobs" / run.run_id)
        log_start(run, config, dataset)
        vae, head = train_on_pictures(job, dataset)
        arrays, gate = train_gate(job, encode_and_cluster(job, dataset, vae))
        local = train_local(job, arrays)
        final = train_global(job, arrays, local)
        _LOG.info("bundle: exporting")
        parts = TrainedParts(
            vae.checkpoint,
            tuple(outcome.checkpoint for outcome in (final or local)),
            _checkpoint(gate),
            _checkpoint(head),
            arrays,
        )
        bundle = make_bundle(job.folder / "bundle", config, dataset, parts)
        outcomes = [outcome for outcome in (vae, head, gate, *local, *final) if outcome is not None]
        figures = log_result(run, bundle, dataset, outcomes)
        return _register(job, dataset, bundle, outcomes, figures)


def prepare_data(config: TrainConfig, data_folder: Path) -> Dataset:
    """The user's own data set, or the configured one, generated unless it is there already."""
    if config.data_folder is not None:
        return open_dataset(config.data_folder)
    return generate(config.data, data_folder / "datasets" / config.data.folder_name)


def train_on_pictures(job: _Job, dataset: Dataset) -> tuple[TrialOutcome, TrialOutcome | None]:
    """Stage 3: one VAE over all pictures, shared by every later trial; the validity head beside it.

    Without configurations in collision, or with no steps for it, there is no head.
    """
    config = job.config
    images = np.asarray(dataset.images)
    if dataset.extra_images is not None:
        images = np.concatenate([images, dataset.extra_images])
    occupancy = OccupancyArrays.of(dataset) if config.validity.steps > 0 else None
    names = [VAE] if occupancy is None else [VAE, VALIDITY]
    _LOG.info("%s: %d pictures", " and ".join(names), len(images))
    trials = [{"name": name, "run_id": job.child(name), "seed": config.seed} for name in names]
    shared = {
        "train": config,
        "images": images,
        "occupancy": occupancy,
        "tracking_uri": job.environment.tracking_uri,
    }
    vae, *head = run_trials(picture_trial, trials, shared, config.resources, job.folder / "pictures")
    return vae, head[0] if head else None


def encode_and_cluster(job: _Job, dataset: Dataset, vae: TrialOutcome) -> TrainingArrays:
    """Stage 4: latents of the scenarios, k-means over the configuration space, and cells for the gate."""
    config = job.config
    encoder = load_encoder(config.vae, dataset.camera.pixels, vae.checkpoint)
    images = np.asarray(dataset.images)
    latents = encode(encoder, images)
    free = np.asarray(dataset.free)
    ids = np.repeat(np.arange(dataset.scenario_count), np.diff(dataset.free_offsets))
    labels, cells = _partition(config, free)
    sizes = np.bincount(labels, minlength=config.clusters.count)
    _LOG.info("clusters: sizes %s", ", ".join(map(str, sizes)))
    looked_up = any(
        part.points_per_link
        for gan in (config.local, config.global_)
        for part in (gan.generator_lookups, gan.critic_lookups)
    )
    return TrainingArrays(
        free,
        ids,
        labels,
        latents.mu,
        latents.sigma,
        dataset.robot,
        dataset.camera,
        images if looked_up else None,
        cells,
    )


def _partition(config: TrainConfig, free: NDArray[np.float32]) -> tuple[NDArray[np.int64], GatedCells | None]:
    """The cluster of each configuration; with a gate, clusters are groups of its cells."""
    count, rows, seed = config.clusters.count, config.clusters.fit_samples, config.seed
    if config.gate.cells == 0:
        return cluster(free, count, rows, seed).labels, None
    cells = cluster(free, config.gate.cells, rows, seed)
    clusters = group(cells, count, seed)
    points = points_in_cells(cells, config.gate.points, seed)
    return clusters[cells.labels], GatedCells(points, cells.labels, clusters)


def train_gate(job: _Job, arrays: TrainingArrays) -> tuple[TrainingArrays, TrialOutcome | None]:
    """Stage 5, where there are cells: the gate, and what it says of every scenario."""
    if arrays.cells is None:
        return arrays, None
    trial = {"name": GATE, "run_id": job.child(GATE), "seed": job.config.seed}
    gate = run_trials(gate_trial, [trial], job.shared(arrays), job.config.resources, job.folder / GATE)[0]
    probabilities = gate_probabilities(load_gate(job.config, gate.checkpoint), arrays.mu)
    return replace(arrays, cells=replace(arrays.cells, probabilities=probabilities)), gate


def train_local(job: _Job, arrays: TrainingArrays) -> list[TrialOutcome]:
    """Stage 6: one WGAN-GP a cluster, in parallel."""
    trials = [
        {
            "name": f"local-{index}",
            "run_id": job.child(f"local-{index}"),
            "seed": job.config.seed + 1 + index,
            "cluster": index,
        }
        for index in range(job.config.clusters.count)
    ]
    return run_trials(local_trial, trials, job.shared(arrays), job.config.resources, job.folder / "local")


def train_global(job: _Job, arrays: TrainingArrays, local: Sequence[TrialOutcome]) -> list[TrialOutcome]:
    """Stage 7: the global WGAN-GP guided by the local critics, or one generator that distils the mixture.

    A mixture needs neither: its local generators are what is served.
    """
    form = job.config.clusters.form
    if form == "mixture":
        return []
    name, trainable = (GLOBAL, global_trial) if form == "guided" else (DISTILLED, distillation_trial)
    trial = {"name": name, "run_id": job.child(name), "seed": job.config.seed}
    shared = {
        **job.shared(arrays),
        "local_checkpoints": [str(outcome.checkpoint) for outcome in local],
    }
    return run_trials(trainable, [trial], shared, job.config.resources, job.folder / name)


def _checkpoint(outcome: TrialOutcome | None) -> Path | None:
    return None if outcome is None else outcome.checkpoint


def _register(
    job: _Job, dataset: Dataset, bundle: Bundle, outcomes: Sequence[TrialOutcome], figures: tuple[str, ...]
) -> TrainResult:
    registry = MlflowRegistry(job.environment.tracking_uri)
    tags = {"data_digest": dataset.digest, "preset": job.config.preset, "seed": str(job.config.seed)}
    version = registry.register(
        MODEL_NAME, bundle.folder, job.run.run_id, bundle.digest, tags, alias=ALIAS_CHALLENGER
    )
    _LOG.info("registry: %s version %d, alias %s", MODEL_NAME, version.number, ALIAS_CHALLENGER)
    return TrainResult(
        run_id=job.run.run_id,
        model=MODEL_NAME,
        version=version.number,
        digest=bundle.digest,
        data_digest=dataset.digest,
        metrics=outcomes[-1].metrics,
        trials={outcome.name: (outcome.started_s, outcome.ended_s) for outcome in outcomes},
        figures=figures,
    )


def _tags(config: TrainConfig) -> dict[str, str]:
    source = source_state()
    return {
        "preset": config.preset,
        "seed": str(config.seed),
        "git.commit": source.commit,
        "git.dirty": str(source.dirty),
        # What MLflow's UI shows as the source.
        "mlflow.source.git.commit": source.commit,
        "mlflow.source.name": "training/cluster_train.py",
        "mlflow.source.type": "JOB",
    }
