"""The main job: data, VAE and validity head, clusters, local trials, global trial, bundle, registry."""

import logging
import shutil
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from cspace.bundle import Bundle
from cspace.dataset import Dataset, open_dataset
from cspace.errors import ConfigError
from services.registry.mlflow_registry import MlflowRegistry
from services.registry.names import ALIAS_CHALLENGER, MODEL_NAME
from training.bundling import TrainedParts, make_bundle
from training.clustering import cluster
from training.config import TrainConfig
from training.datasets.generate import generate
from training.encode import Latents, encode, load_encoder
from training.environment import Environment
from training.job import Job
from training.provenance import source_state
from training.reporting import log_result, log_start
from training.trials.launch import TrialOutcome, connect, run_trials
from training.trials.occupancy import OccupancyArrays
from training.trials.trainables import (
    VAE,
    VALIDITY,
    TrainingArrays,
    global_trial,
    joint_trial,
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


def train(config: TrainConfig, environment: Environment) -> TrainResult:
    """Run the whole job.

    Raises:
        CspaceError: bad data, a failed trial, or a registry that does not answer.
    """
    connect()
    return _run(Job.start(config, environment, _tags(config)))


def resume(run_id: str, environment: Environment) -> TrainResult:
    """Go on with a job that was stopped: finished trials stay, others start from their checkpoints.

    Args:
        run_id: the job's parent run.
        environment: the same as the job's.

    Raises:
        CspaceError: as for :func:`train`; ConfigError where there is no such job.
    """
    connect()
    return _run(Job.resume(run_id, environment))


def _run(job: Job) -> TrainResult:
    with job.run as run:
        _LOG.info("run: %s", run.run_id)
        dataset = prepare_data(job.config, job.environment.data_folder)
        log_start(run, job.config, dataset)
        vae, head = train_on_pictures(job, dataset)
        arrays = encode_and_cluster(job, dataset, vae)
        local = train_local(job, arrays)
        final = train_global(job, dataset, arrays, local)
        _LOG.info("bundle: exporting")
        encoder = final.checkpoint if job.config.joint else _encoder_checkpoint(job, vae)
        validity = None if head is None else head.checkpoint
        parts = TrainedParts(encoder, final.checkpoint, validity, arrays.scale)
        shutil.rmtree(job.folder / "bundle", ignore_errors=True)
        bundle = make_bundle(job.folder / "bundle", job.config, dataset, parts)
        outcomes = [outcome for outcome in (vae, head, *local, final) if outcome is not None]
        figures = log_result(run, bundle, dataset, {outcome.name: outcome for outcome in outcomes})
        return _register(job, dataset, bundle, outcomes, figures)


def prepare_data(config: TrainConfig, data_folder: Path) -> Dataset:
    """The user's own data set, or the configured one, generated unless it is there already."""
    if config.data_folder is not None:
        return open_dataset(config.data_folder)
    return generate(config.data, data_folder / "datasets" / config.data.folder_name)


def train_on_pictures(job: Job, dataset: Dataset) -> tuple[TrialOutcome | None, TrialOutcome | None]:
    """Stage 3: one VAE over all pictures, shared by every later trial; the validity head beside it.

    Without configurations in collision, or with no steps for it, there is no head; with an encoder that is
    there already, or that is trained with the generator, there is no VAE.
    """
    config = job.config
    images = np.asarray(dataset.images)
    if dataset.extra_images is not None:
        images = np.concatenate([images, dataset.extra_images])
    occupancy = OccupancyArrays.of(dataset) if config.validity.steps > 0 else None
    vae = not config.joint and config.vae.checkpoint is None
    names = [name for name, wanted in ((VAE, vae), (VALIDITY, occupancy is not None)) if wanted]
    if not names:
        return None, None
    _LOG.info("%s: %d pictures", " and ".join(names), len(images))
    trials = [{"name": name, "run_id": job.child(name), "seed": config.seed} for name in names]
    shared = {
        "train": config,
        "images": images,
        "occupancy": occupancy,
        "tracking_uri": job.environment.tracking_uri,
    }
    done = run_trials(picture_trial, trials, shared, config.resources, job.folder / "pictures")
    outcomes = {outcome.name: outcome for outcome in done}
    return outcomes.get(VAE), outcomes.get(VALIDITY)


def encode_and_cluster(job: Job, dataset: Dataset, vae: TrialOutcome | None) -> TrainingArrays:
    """Stage 4: latents of the scenarios and k-means over the configuration space.

    An encoder that is yet to be trained with the generator leaves the latents at zero.
    """
    config, images = job.config, np.asarray(dataset.images)
    if config.joint:
        latents = Latents.none(len(images), config.vae.latent_dim)
    else:
        encoder = load_encoder(config.vae, dataset.camera.pixels, _encoder_checkpoint(job, vae))
        latents = encode(encoder, images)
    free = np.asarray(dataset.free)
    clusters = cluster(free, config.clusters.count, config.clusters.fit_samples, config.seed)
    _LOG.info("clusters: sizes %s", ", ".join(str(size) for size in clusters.sizes))
    ids = np.repeat(np.arange(dataset.scenario_count), np.diff(dataset.free_offsets))
    return TrainingArrays(free, ids, clusters.labels, latents.mu, latents.sigma)


def train_local(job: Job, arrays: TrainingArrays) -> list[TrialOutcome]:
    """Stage 5: one WGAN-GP a cluster, in parallel."""
    trials = [
        {
            "name": f"local-{index}",
            "run_id": job.child(f"local-{index}"),
            "seed": job.config.seed + 1 + index,
            "cluster": index,
        }
        for index in range(job.config.local_trials)
    ]
    if not trials:
        return []
    shared = {"train": job.config, "arrays": arrays, "tracking_uri": job.environment.tracking_uri}
    return run_trials(local_trial, trials, shared, job.config.resources, job.folder / "local")


def train_global(
    job: Job, dataset: Dataset, arrays: TrainingArrays, local: Sequence[TrialOutcome]
) -> TrialOutcome:
    """Stage 6: the global WGAN-GP, guided by the local critics, or with the encoder that it trains."""
    trial = {"name": "global", "run_id": job.child("global"), "seed": job.config.seed}
    shared = {"train": job.config, "arrays": arrays, "tracking_uri": job.environment.tracking_uri}
    if job.config.joint:
        shared["images"] = np.asarray(dataset.images)
    else:
        shared["local_checkpoints"] = [str(outcome.checkpoint) for outcome in local]
    trainable = joint_trial if job.config.joint else global_trial
    return run_trials(trainable, [trial], shared, job.config.resources, job.folder / "global")[0]


def _encoder_checkpoint(job: Job, vae: TrialOutcome | None) -> Path:
    """Where the encoder's weights are: in the job's own VAE trial, or where the configuration says."""
    given = job.config.vae.checkpoint
    if vae is not None:
        return vae.checkpoint
    if given is None or not given.is_dir():
        raise ConfigError("there is no encoder", expected="a VAE trial's checkpoint", got=str(given))
    return given


def _register(
    job: Job, dataset: Dataset, bundle: Bundle, outcomes: Sequence[TrialOutcome], figures: tuple[str, ...]
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
