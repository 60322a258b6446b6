"""The job of the path model: data, what a bundle sees of them, the trial, the bundle, the registry."""

import logging
from pathlib import Path

import numpy as np
import torch

from cspace.bundle import Bundle, RandomInput, load_verified
from cspace.dataset import Dataset, open_dataset
from cspace.errors import ConfigError
from cspace.space import JointSpace
from services.commands import Progress
from services.names import TAG_MODEL, recorded_name
from services.registry.entities import ModelReference
from services.registry.models import ModelRegistry
from training.config import PathTrainConfig
from training.data.generate import generate
from training.jobs.fit import fit_tracked
from training.jobs.job import BUNDLE_FOLDER, Job, JobResult, kept_bundle, registered_name, world_tag
from training.jobs.launch import TrialOutcome, TrialRequest, run_trials
from training.models.checkpoint import seeded_initialisation, trained
from training.models.families.wgan_gp import Sizes
from training.models.paths import (
    PathGanModule,
    PathGenerator,
    PathSamples,
    equal_paths,
    point_graph,
)
from training.path_sampler import write_path_bundle

_LOG = logging.getLogger("training")

MODEL = "wgan"


def run_job(job: Job[PathTrainConfig]) -> JobResult:
    """Run the whole job, or go on with it: finished trials stay, others start from their checkpoints."""
    config = job.config
    with job.running() as run:
        registry = ModelRegistry(job.environment.tracking_uri)
        source = job.patiently(
            "fetching the source", lambda: source_bundle(config.source, registry, job.folder / "source")
        )
        named = config.robot_name or recorded_name(source.spec.provenance.config)
        model = registered_name(job, source.spec.world, named, path=True)
        if config.world != source.spec.world:
            raise ConfigError(
                "the paths are of another robot or camera than the bundle",
                expected=str(source.spec.world),
                got=str(config.world),
            )
        dataset = _data(config, job.environment.data_folder)
        job.log_configuration()
        run.dataset(dataset.folder.name, dataset.digest, str(dataset.folder), "training")
        job.add_tags(world_tag(source.spec.world, named))
        samples = path_samples(source, dataset, config.points)
        _LOG.info("path model: %d paths", len(samples.ids))
        (trial,) = run_trials(job, "models", [MODEL], path_trial, samples=samples, space=dataset.world.space)
        _LOG.info("bundle: exporting %s", MODEL)
        folder = job.folder / BUNDLE_FOLDER
        bundle = kept_bundle(folder) or trained_bundle(folder, job, trial, source, dataset)
        trained_by = job.child(MODEL)
        tags = {"path_model": MODEL, "data_digest": bundle.spec.provenance.data_digest or ""}
        version = job.register(model, bundle, trained_by, tags)
        job.tracking.note(trained_by, tags={TAG_MODEL: str(version)})
        return JobResult(
            run_id=run.run_id,
            model=model,
            version=version,
            digest=bundle.digest,
            data_digest=dataset.digest,
            metrics=trial.metrics,
            trials={MODEL: trial.times_s},
            figures=(),
        )


def source_bundle(source: str, registry: ModelRegistry, folder: Path) -> Bundle:
    """A bundle's folder, or a registered version that is fetched."""
    if Path(source).is_absolute():
        return load_verified(Path(source))
    if folder.is_dir():
        return Bundle.load(folder)
    reference = ModelReference.parse_version(
        source, "the source of the path models is unknown", "a bundle's folder, name@alias or name/version"
    )
    return load_verified(registry.download(registry.look_up(reference), folder))


def _data(config: PathTrainConfig, folder: Path) -> Dataset:
    if config.data_folder is not None:
        return open_dataset(config.data_folder)
    return generate(config.data, folder / "datasets" / f"paths-{config.data.folder_name}")


def path_samples(bundle: Bundle, dataset: Dataset, points: int) -> PathSamples:
    """Paths, and the latents of all scenarios by a bundle's encoder."""
    paths, ids = equal_paths(dataset, points)
    latents = []
    with Progress("pictures", len(dataset.images), _LOG.info, "picture") as progress:
        for image in dataset.images:
            latents.append(bundle.prepare(image).encoding)
            progress.advance()
    mu, sigma = (np.stack([getattr(one, name) for one in latents]) for name in ("mu", "sigma"))
    return PathSamples(*(torch.tensor(part) for part in (paths, ids, mu, sigma)))


def path_trial(trial: TrialRequest, train: PathTrainConfig, samples: PathSamples, space: JointSpace) -> None:
    """Train the path model."""
    with seeded_initialisation(trial.seed):
        module = PathGanModule(train.wgan, samples, trial.seed, space)
    fit_tracked(trial, module, train.wgan, train.resources)


def trained_bundle(
    folder: Path, job: Job[PathTrainConfig], trial: TrialOutcome, source: Bundle, dataset: Dataset
) -> Bundle:
    """The bundle of the trained path model."""
    config, spec = job.config, source.spec
    sizes = Sizes(spec.world.space, spec.latent_dim, config.wgan.hidden, config.wgan.layers)
    net = trained(lambda: PathGenerator(sizes, config.wgan.noise_dim), trial.checkpoint, "net")
    graph, noise = point_graph(net, spec.latent_dim), RandomInput("noise", "normal", (net.noise_dim,))
    seeds = {"training": config.seed, "data": dataset.generator_seed}
    recipe = {"path_model": MODEL, "source_digest": source.digest, **config.to_dict()}
    metrics = {**trial.metrics, "training_s": trial.seconds}
    return write_path_bundle(folder, source, graph, (noise,), dataset.digest, seeds, recipe, metrics)
