"""The main job: data, clusters, VAE and validity head, the model family's trials, bundle, registry."""

import logging
from dataclasses import replace
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from cspace.bundle import Bundle
from cspace.dataset import Dataset, open_dataset
from cspace.errors import ConfigError, DatasetError
from cspace.simulator import ORIGINS, Split
from cspace.space import JointSpace
from services.evaluator.report import gallery
from services.evaluator.scenes import Scene, Stage
from services.names import TAG_MODEL, label, recorded_name
from services.planner.samples import BundleSampler
from services.registry.tracking import RunLog
from training.clusters.bundling import TrainedParts, make_bundle
from training.clusters.clustering import Partition, cluster, group
from training.config import CLUSTERS_FILE, TrainConfig
from training.data.generate import generate
from training.jobs.job import BUNDLE_FOLDER, Job, JobResult, kept_bundle, registered_name, world_tag
from training.jobs.launch import TrialOutcome, run_trials
from training.jobs.trials import VAE, VALIDITY, family_trial, has_occupancy, picture_trial
from training.models.autoencoders import encode, load_encoder, shown
from training.models.data import TrainingArrays
from training.models.families import family

SHOWN_SCENARIOS = 3


def log_result(run: RunLog, bundle: Bundle, dataset: Dataset, final: TrialOutcome) -> tuple[str, ...]:
    """Samples against truth for seen and unseen scenarios, and the last metrics; the figures' names."""
    figures = _galleries(bundle, dataset)
    for name, figure in figures.items():
        run.figure(figure, name)
    last = {f"last/{name}": value for name, value in final.metrics.items() if name != "steps_per_s"}
    # The same moment for a job that goes on, so that it is one point.
    run.metrics(last, 0, round(1e3 * final.times_s[1]))
    return tuple(figures)


def _galleries(bundle: Bundle, dataset: Dataset) -> dict[str, Figure]:
    """Galleries where the truth is known: generated scenarios, and unseen ones of the same robot.

    Of data whose world nobody can draw further scenes of there is none.
    """
    figures: dict[str, Figure] = {}
    sampler = BundleSampler(bundle)
    seed = dataset.generator_seed
    if seed is not None:
        seen = _scenes(dataset, Split.TRAIN, seed)
        figures["samples-seen"] = gallery(seen, sampler, "training scenarios")
    if dataset.world.scenes is not None:
        unseen = _scenes(dataset, Split.VALIDATION, 0)
        figures["samples-unseen"] = gallery(unseen, sampler, "unseen scenarios")
    return figures


def _scenes(dataset: Dataset, split: Split, seed: int) -> list[Scene]:
    stage = Stage(dataset.world, split, seed)
    return [Scene(stage, index) for index in range(SHOWN_SCENARIOS)]


_LOG = logging.getLogger("training")


def prepare_data(config: TrainConfig, data_folder: Path) -> Dataset:
    """The user's own data set, or the configured one, generated unless it is there already."""
    if config.data_folder is not None:
        return open_dataset(config.data_folder)
    generated = config.data.model_copy(update={"outcomes": None})
    return generate(generated, data_folder / "datasets" / generated.folder_name)


def open_outcomes(config: TrainConfig, dataset: Dataset) -> Dataset | None:
    """The data set of outcomes that a head learns from beside the other; None without one."""
    folder = config.data.outcomes
    if folder is None:
        return None
    found = open_dataset(folder)
    ours, theirs = ((one.world.body, one.world.sensor) for one in (dataset, found))
    if ours != theirs or found.collision is None:
        raise DatasetError(
            "data.outcomes does not fit",
            expected=f"what python -m training.data import-outcomes writes for {ours}"[:300],
            got=f"{theirs} in {folder}"[:300],
            remedy="import them with the options of the training's robot",
        )
    return found


def train_on_pictures(
    job: Job[TrainConfig], dataset: Dataset
) -> tuple[TrialOutcome | None, TrialOutcome | None]:
    """Stage 3: one VAE over all pictures, shared by every later trial; the validity head beside it.

    Without configurations in collision, with no steps for it, or with a scene model, no head is trained, but
    with outcomes a scene model is trained further; with an encoder that is there already, or that is trained
    with the generator, no VAE is.
    """
    config = job.config
    sensor = dataset.world.sensor
    images = shown(sensor, dataset.images)
    if dataset.extra_images is not None:
        images = np.concatenate([images, shown(sensor, dataset.extra_images)])
    given = config.validity.scene_model is not None and config.data.outcomes is None
    trained = config.validity.steps > 0 and not given
    head = trained and has_occupancy(dataset, config.validity)
    vae = not config.trains_encoder and config.vae.checkpoint is None
    names = [name for name, wanted in ((VAE, vae), (VALIDITY, head)) if wanted]
    if not names:
        return None, None
    _LOG.info("%s: %d pictures", " and ".join(names), len(images))
    folder = dataset.folder.absolute()
    done = run_trials(job, "pictures", names, picture_trial, images=images, data_folder=folder)
    outcomes = {outcome.name: outcome for outcome in done}
    return outcomes.get(VAE), outcomes.get(VALIDITY)


def cluster_data(job: Job[TrainConfig], dataset: Dataset) -> TrainingArrays:
    """Stage 2: k-means over the configuration space, and cells for the gate; before anything is trained.

    A job that goes on reads the clusters that it wrote.
    """
    config, path = job.config, job.folder / CLUSTERS_FILE
    free, ids = uniform_free(dataset)
    parted = Partition.read(path, free, dataset.world.space)
    if parted is None:
        parted = partition(config, free, dataset.world.space)
        parted.save(path)
    sizes = np.bincount(parted.labels, minlength=config.clusters.count)
    _LOG.info("clusters: sizes %s", ", ".join(map(str, sizes)))
    cells = parted.with_points(config.cell_points, config.seed)
    nothing = np.zeros((dataset.scenario_count, config.vae.latent_dim), dtype=np.float32)
    return TrainingArrays(free, ids, parted.labels, nothing, nothing, dataset.world, cells=cells)


def encode_data(
    job: Job[TrainConfig], dataset: Dataset, vae: TrialOutcome | None, arrays: TrainingArrays
) -> TrainingArrays:
    """Stage 4: latents of the scenarios beside the clustered configurations.

    An encoder that is yet to be trained with the generator leaves the latents at zero.
    """
    config, sensor = job.config, dataset.world.sensor
    if not config.trains_encoder:
        encoder = load_encoder(config.vae, sensor, encoder_checkpoint(job, vae))
        mu, sigma = encode(encoder, sensor, dataset.images)
        arrays = replace(arrays, mu=mu, sigma=sigma)
    return replace(arrays, images=np.asarray(dataset.images)) if config.reads_pictures else arrays


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


def partition(config: TrainConfig, free: NDArray[np.float32], space: JointSpace) -> Partition:
    """Cells and clusters of (M, d) configurations."""
    cells = cluster(free, config.cells, config.seed, space)
    return Partition(cells, group(cells, config.clusters.count, config.seed))


def train_family(job: Job[TrainConfig], arrays: TrainingArrays) -> list[TrialOutcome]:
    """Stages 5 and on: what the model family trains from the latents."""
    config, outcomes = job.config, list[TrialOutcome]()
    kind = family(config.clusters.form)
    for stage, names in kind(config, arrays).stages().items():
        done = {outcome.name: outcome.checkpoint for outcome in outcomes}
        outcomes += run_trials(job, stage, names, family_trial, kind=kind, arrays=arrays, done=done)
    return outcomes


def encoder_checkpoint(job: Job[TrainConfig], vae: TrialOutcome | None) -> Path:
    """Where the encoder's weights are: in the job's own VAE trial, or where the configuration says."""
    given = job.config.vae.checkpoint
    if vae is not None:
        return vae.checkpoint
    if given is None or not given.is_file():
        raise ConfigError("there is no encoder", expected="a VAE trial's checkpoint", got=str(given))
    return given


def run_job(job: Job[TrainConfig]) -> JobResult:
    """Run the whole job, or go on with it: finished trials stay, others start from their checkpoints."""
    with job.running() as run:
        dataset = prepare_data(job.config, job.environment.data_folder)
        # The configuration's name for the robot, else that of its data, else that of its description.
        config = job.config
        if config.robot_name is None:
            named = recorded_name(dataset.manifest.generator) or label(dataset.world)
            config = config.model_copy(update={"robot_name": named})
        model = registered_name(job, dataset.world, config.robot_name, path=False)
        job.log_configuration()
        for one in (dataset, open_outcomes(job.config, dataset)):
            if one is not None:
                run.dataset(one.folder.name, one.digest, str(one.folder), "training")
        job.add_tags(world_tag(dataset.world, config.robot_name))
        data = cluster_data(job, dataset)
        vae, head = train_on_pictures(job, dataset)
        arrays = encode_data(job, dataset, vae, data)
        trained = train_family(job, arrays)
        _LOG.info("bundle: exporting")
        encoder = trained[-1].checkpoint if config.trains_encoder else encoder_checkpoint(job, vae)
        head_at = config.validity.scene_model_file if head is None else head.checkpoint
        done = {outcome.name: outcome.checkpoint for outcome in trained}
        parts = TrainedParts(encoder, done, head_at, arrays)
        bundle = kept_bundle(job.folder / BUNDLE_FOLDER)
        if bundle is None:
            bundle = make_bundle(job.folder / BUNDLE_FOLDER, config, dataset, parts)
        outcomes = [*(outcome for outcome in (vae, head) if outcome is not None), *trained]
        figures = log_result(run, bundle, dataset, outcomes[-1])
        version = job.register(model, bundle, run.run_id, {"data_digest": dataset.digest})
        job.add_tags({TAG_MODEL: str(version)})
    return JobResult(
        run_id=job.run.run_id,
        model=model,
        version=version,
        digest=bundle.digest,
        data_digest=dataset.digest,
        metrics=outcomes[-1].metrics,
        trials={outcome.name: outcome.times_s for outcome in outcomes},
        figures=figures,
    )
