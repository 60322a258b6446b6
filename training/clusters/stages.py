"""The stages of a training job, each from what the one before left."""

import logging
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cspace.dataset import Dataset, open_dataset
from cspace.errors import ConfigError
from cspace.space import JointSpace
from cspace.workshop import ORIGINS
from training.clusters.clustering import Partition, cluster, group
from training.config.clusters import CLUSTERS_FILE, TrainConfig
from training.datasets.generate import generate
from training.jobs.job import Job
from training.models.encode import Latents, encode, load_encoder
from training.models.gate import gate_probabilities
from training.models.pictures.autoencoders import shown
from training.trials.arrays import GatedCells, TrainingArrays
from training.trials.grid_occupancy import GridOccupancy
from training.trials.launch import run_trials
from training.trials.loading import load_gate
from training.trials.occupancy import OccupancyArrays
from training.trials.outcomes import TrialOutcome
from training.trials.request import TrialRequest
from training.trials.trainables import (
    DISTILLED,
    GATE,
    GLOBAL,
    VAE,
    VALIDITY,
    distillation_trial,
    gate_trial,
    global_trial,
    joint_trial,
    local_trial,
    picture_trial,
)

_LOG = logging.getLogger("training")


def prepare_data(config: TrainConfig, data_folder: Path) -> Dataset:
    """The user's own data set, or the configured one, generated unless it is there already."""
    if config.data_folder is not None:
        return open_dataset(config.data_folder)
    return generate(config.data, data_folder / "datasets" / config.data.folder_name)


def train_on_pictures(
    job: Job[TrainConfig], dataset: Dataset
) -> tuple[TrialOutcome | None, TrialOutcome | None]:
    """Stage 3: one VAE over all pictures, shared by every later trial; the validity head beside it.

    Without configurations in collision, or with no steps for it, there is no head; with an encoder that is
    there already, or that is trained with the generator, there is no VAE.
    """
    config = job.config
    sensor = dataset.world.sensor
    images = shown(sensor, dataset.images)
    if dataset.extra_images is not None:
        images = np.concatenate([images, shown(sensor, dataset.extra_images)])
    arrays = OccupancyArrays if config.validity.grid is None else GridOccupancy
    occupancy = arrays.of(dataset) if config.validity.steps > 0 else None
    vae = not config.joint and config.vae.checkpoint is None
    names = [name for name, wanted in ((VAE, vae), (VALIDITY, occupancy is not None)) if wanted]
    if not names:
        return None, None
    _LOG.info("%s: %d pictures", " and ".join(names), len(images))
    trials = [TrialRequest.of(job, "pictures", name) for name in names]
    shared = {
        "train": config,
        "images": images,
        "occupancy": occupancy,
        "tracking_uri": job.environment.tracking_uri,
    }
    done = run_trials(picture_trial, trials, shared, config.resources)
    outcomes = {outcome.name: outcome for outcome in done}
    return outcomes.get(VAE), outcomes.get(VALIDITY)


@dataclass(frozen=True, slots=True)
class ClusteredData:
    """Free configurations in their clusters.

    Args:
        free: (M, d) float32 rad.
        ids: (M,) int64 scenario of each.
        labels: (M,) int64 cluster of each.
        cells: of the gate; None without one.
    """

    free: NDArray[np.float32]
    ids: NDArray[np.int64]
    labels: NDArray[np.int64]
    cells: GatedCells | None


def cluster_data(job: Job[TrainConfig], dataset: Dataset) -> ClusteredData:
    """Stage 2: k-means over the configuration space, and cells for the gate; before anything is trained.

    A job that goes on reads the clusters that it wrote.

    Raises:
        ConfigError: the data do not fit the clusters that are asked for.
    """
    config, path = job.config, job.folder / CLUSTERS_FILE
    free, ids = uniform_free(dataset)
    parted = Partition.read(path, free, dataset.world.space)
    if parted is None:
        parted = partition(config, free, dataset.world.space, job.start_folder)
        parted.save(path)
    sizes = np.bincount(parted.labels, minlength=config.clusters.count)
    _LOG.info("clusters: sizes %s", ", ".join(map(str, sizes)))
    return ClusteredData(free, ids, parted.labels, parted.gated(config.gate, config.seed))


def encode_data(
    job: Job[TrainConfig], dataset: Dataset, vae: TrialOutcome | None, data: ClusteredData
) -> TrainingArrays:
    """Stage 4: latents of the scenarios beside the clustered configurations.

    An encoder that is yet to be trained with the generator leaves the latents at zero.
    """
    config, images = job.config, dataset.images
    if config.joint:
        latents = Latents.none(len(images), config.vae.latent_dim)
    else:
        sensor = dataset.world.sensor
        encoder = load_encoder(config.vae, sensor, encoder_checkpoint(job, vae))
        latents = encode(encoder, sensor, images)
    looked_up = any(
        part.points_per_link
        for gan in (config.local, config.global_)
        for part in (gan.generator_lookups, gan.critic_lookups)
    )
    return TrainingArrays(
        data.free,
        data.ids,
        data.labels,
        latents.mu,
        latents.sigma,
        dataset.world,
        np.asarray(images) if looked_up else None,
        data.cells,
    )


def uniform_free(dataset: Dataset) -> tuple[NDArray[np.float32], NDArray[np.int64]]:
    """Free configurations (M, d) that were drawn uniformly, and the scenario of each, (M,).

    Where a data set does not tell how they were drawn, these are all.
    """
    free = np.asarray(dataset.free)
    ids = np.repeat(np.arange(dataset.scenario_count), np.diff(dataset.free_offsets))
    origins = dataset.arrays.get("free_origin")
    if origins is None:
        return free, ids
    uniform = np.asarray(origins) == ORIGINS.index("uniform")
    return free[uniform], ids[uniform]


def partition(
    config: TrainConfig, free: NDArray[np.float32], space: JointSpace, start: Path | None = None
) -> Partition:
    """Cells and clusters of (M, d) configurations: new ones, or those of the job in the folder ``start``."""
    count, seed = config.clusters.count, config.seed
    if start is not None:
        return Partition.load(start / CLUSTERS_FILE, free, space)
    cells = cluster(free, config.gate.cells or count, config.clusters.fit_samples, seed, space)
    return Partition(cells, group(cells, count, seed))


def train_gate(job: Job[TrainConfig], arrays: TrainingArrays) -> tuple[TrainingArrays, TrialOutcome | None]:
    """Stage 5, where there are cells: the gate, and what it says of every scenario."""
    if arrays.cells is None:
        return arrays, None
    trial = TrialRequest.of(job, GATE, GATE)
    gate = run_trials(gate_trial, [trial], _shared(job, arrays), job.config.resources)[0]
    probabilities = gate_probabilities(load_gate(job.config, gate.checkpoint), arrays.mu)
    return replace(arrays, cells=replace(arrays.cells, probabilities=probabilities)), gate


def train_local(job: Job[TrainConfig], arrays: TrainingArrays) -> list[TrialOutcome]:
    """Stage 6: one WGAN-GP a cluster, in parallel."""
    count = job.config.local_trials
    trials = [TrialRequest.of(job, "local", f"local-{index}", index) for index in range(count)]
    return run_trials(local_trial, trials, _shared(job, arrays), job.config.resources)


def train_global(
    job: Job[TrainConfig], dataset: Dataset, arrays: TrainingArrays, local: Sequence[TrialOutcome]
) -> list[TrialOutcome]:
    """Stage 7: the global WGAN-GP, guided by the local critics or with the encoder that it trains.

    Or one generator that distils the mixture; a mixture itself needs neither, for its local generators are
    what is served.
    """
    form, shared = job.config.clusters.form, _shared(job, arrays)
    if form == "mixture":
        return []
    trainable: Callable[..., None]
    name, trainable = (DISTILLED, distillation_trial) if form == "distilled" else (GLOBAL, global_trial)
    trial = TrialRequest.of(job, name, name)
    if job.config.joint:
        trainable, shared["images"] = joint_trial, np.asarray(dataset.images)
    else:
        shared["local_checkpoints"] = [str(outcome.checkpoint) for outcome in local]
    return run_trials(trainable, [trial], shared, job.config.resources)


def encoder_checkpoint(job: Job[TrainConfig], vae: TrialOutcome | None) -> Path:
    """Where the encoder's weights are: in the job's own VAE trial, or where the configuration says.

    Raises:
        ConfigError: nowhere.
    """
    given = job.config.vae.checkpoint
    if vae is not None:
        return vae.checkpoint
    if given is None or not given.is_dir():
        raise ConfigError("there is no encoder", expected="a VAE trial's checkpoint", got=str(given))
    return given


def require_encoder(job: Job[TrainConfig], dataset: Dataset) -> None:
    """See that an encoder that the configuration names is there and fits, before anything is trained.

    Raises:
        ConfigError: it is not, or does not.
    """
    config = job.config.vae
    if config.checkpoint is None:
        return
    checkpoint = encoder_checkpoint(job, None)
    try:
        load_encoder(config, dataset.world.sensor, checkpoint)
    except (OSError, RuntimeError) as error:
        raise ConfigError(
            "vae.checkpoint does not fit",
            expected=f"the weights of an encoder with vae.latent_dim={config.latent_dim}, "
            f"vae.width={config.width} and vae.patches={config.patches} for the data's pictures",
            got=f"{checkpoint}: {str(error)[:300]}",
            remedy="name another checkpoint, or set the sizes of its job",
        ) from error


def _shared(job: Job[TrainConfig], arrays: TrainingArrays) -> dict[str, Any]:
    """What every trial on configurations gets."""
    return {"train": job.config, "arrays": arrays, "tracking_uri": job.environment.tracking_uri}
