"""The main job: data, VAE and validity head, clusters, local trials, global trial, bundle, registry."""

import logging
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from cspace.bundle import Bundle
from cspace.dataset import Dataset, open_dataset
from services.registry.mlflow_registry import MlflowRegistry
from services.registry.mlflow_tracking import MlflowTracking
from services.registry.names import ALIAS_CHALLENGER, EXPERIMENT, MODEL_NAME
from services.registry.tracking import RunLog
from training.bundling import TrainedParts, make_bundle
from training.clustering import cluster
from training.config import TrainConfig
from training.datasets.generate import generate
from training.encode import encode, load_encoder
from training.environment import Environment
from training.provenance import source_state
from training.reporting import log_result, log_start
from training.trials.launch import TrialOutcome, connect, run_trials
from training.trials.occupancy import OccupancyArrays
from training.trials.trainables import (
    VAE,
    VALIDITY,
    TrainingArrays,
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
        arrays = encode_and_cluster(job, dataset, vae)
        local = train_local(job, arrays)
        final = train_global(job, arrays, local)
        _LOG.info("bundle: exporting")
        validity = None if head is None else head.checkpoint
        parts = TrainedParts(vae.checkpoint, final.checkpoint, validity, arrays)
        bundle = make_bundle(job.folder / "bundle", config, dataset, parts)
        outcomes = [vae, *([] if head is None else [head]), *local, final]
        figures = log_result(run, bundle, dataset, {outcome.name: outcome for outcome in outcomes})
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
    """Stage 4: latents of the scenarios and k-means over the configuration space."""
    config = job.config
    encoder = load_encoder(config.vae, dataset.camera.pixels, vae.checkpoint)
    latents = encode(encoder, np.asarray(dataset.images))
    free = np.asarray(dataset.free)
    clusters = cluster(free, config.clusters.count, config.clusters.fit_samples, config.seed)
    _LOG.info("clusters: sizes %s", ", ".join(str(size) for size in clusters.sizes))
    ids = np.repeat(np.arange(dataset.scenario_count), np.diff(dataset.free_offsets))
    return TrainingArrays(free, ids, clusters.labels, latents.mu, latents.sigma)


def train_local(job: _Job, arrays: TrainingArrays) -> list[TrialOutcome]:
    """Stage 5: one WGAN-GP a cluster, in parallel."""
    trials = [
        {
            "name": f"local-{index}",
            "run_id": job.child(f"local-{index}"),
            "seed": job.config.seed + 1 + index,
            "cluster": index,
        }
        for index in range(job.config.clusters.count)
    ]
    shared = {"train": job.config, "arrays": arrays, "tracking_uri": job.environment.tracking_uri}
    return run_trials(local_trial, trials, shared, job.config.resources, job.folder / "local")


def train_global(job: _Job, arrays: TrainingArrays, local: Sequence[TrialOutcome]) -> TrialOutcome:
    """Stage 6: the global WGAN-GP, guided by the local critics."""
    trial = {"name": "global", "run_id": job.child("global"), "seed": job.config.seed}
    shared = {
        "train": job.config,
        "arrays": arrays,
        "local_checkpoints": [str(outcome.checkpoint) for outcome in local],
        "tracking_uri": job.environment.tracking_uri,
    }
    return run_trials(global_trial, [trial], shared, job.config.resources, job.folder / "global")[0]


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
