"""The job of the path model: data, what a bundle sees of them, the trial, bundles, registry."""

import logging
from collections.abc import Mapping
from dataclasses import dataclass
from functools import partial
from pathlib import Path

from cspace.bundle import Bundle, RandomInput
from cspace.dataset import Dataset, open_dataset
from cspace.space import JointSpace
from services.commands import numbers
from services.names import ALIAS_CHALLENGER, TAG_MODEL, recorded_name
from services.registry.models import ModelRegistry
from training.config import PathTrainConfig
from training.data.generate import generate
from training.jobs.job import TAG_START, Job, kept_bundle, registered_name, world_tag
from training.models.paths import PathSamples, point_graph
from training.paths.writing import made_or_found, require_source, source_bundle, write_path_bundle
from training.trials.launch import TrialOutcome, run_trials
from training.trials.paths import load_points, path_samples, path_trial, require_world

_LOG = logging.getLogger("training")

# The model that is trained on paths, and the sampler that is not, registered beside it.
MODEL, UNTRAINED = "wgan", "ways"


@dataclass(frozen=True, slots=True)
class PathTrainResult:
    """What a job leaves behind."""

    run_id: str
    model: str
    versions: Mapping[str, int]
    digests: Mapping[str, str]
    data_digest: str
    seconds: Mapping[str, float]

    def rows(self, folder: Path) -> dict[str, str]:
        """The lines of a block for people; the job lies in ``folder``."""
        return {
            "models": ", ".join(f"{self.model}/{number} {name}" for name, number in self.versions.items()),
            "run": self.run_id,
            "trials": numbers(self.seconds, " s"),
            "data": self.data_digest,
            "bundles": str(folder / "bundles"),
        }


def run_job(job: Job[PathTrainConfig]) -> PathTrainResult:
    """Run the whole job, or go on with it: finished trials stay, others start from their checkpoints."""
    config = job.config
    with job.running() as run:
        registry = ModelRegistry(job.environment.tracking_uri)
        source = job.patiently(
            "fetching the source", lambda: source_bundle(config.source, registry, job.folder / "source")
        )
        named = config.robot_name or recorded_name(source.spec.provenance.config)
        model = registered_name(job, source.spec.world, named, path=True)
        require_source(job.start_folder, source)
        require_world(source, config.world)
        dataset = _data(config, job.environment.data_folder)
        job.log_configuration()
        run.dataset(dataset.folder.name, dataset.digest, str(dataset.folder), "training")
        job.add_tags(world_tag(source.spec.world, named))
        samples = path_samples(source, dataset, config.points)
        outcome = _train(job, samples, dataset.world.space)
        run.flush()
        bundles = _bundles(job, source, dataset, outcome)
        versions = {
            name: job.patiently(f"registering {name}", partial(_register, job, registry, model, name, bundle))
            for name, bundle in bundles.items()
        }
        return PathTrainResult(
            run_id=run.run_id,
            model=model,
            versions=versions,
            digests={name: bundle.digest for name, bundle in bundles.items()},
            data_digest=dataset.digest,
            seconds={MODEL: outcome.seconds},
        )


def _data(config: PathTrainConfig, folder: Path) -> Dataset:
    if config.data_folder is not None:
        return open_dataset(config.data_folder)
    return generate(config.data, folder / "datasets" / f"paths-{config.data.folder_name}")


def _train(job: Job[PathTrainConfig], samples: PathSamples, space: JointSpace) -> TrialOutcome:
    _LOG.info("path model: %d paths", len(samples.ids))
    (outcome,) = run_trials(job, "models", [MODEL], path_trial, samples=samples, space=space)
    return outcome


def _bundles(
    job: Job[PathTrainConfig],
    source: Bundle,
    dataset: Dataset,
    outcome: TrialOutcome,
) -> dict[str, Bundle]:
    """The untrained sampler's bundle, where the source has a head for it, and the trained one's."""
    bundles: dict[str, Bundle] = {}
    if source.has_validity:
        bundles[UNTRAINED] = made_or_found(source, job.folder / "bundles" / UNTRAINED)
    _LOG.info("bundle: exporting %s", MODEL)
    folder = job.folder / "bundles" / MODEL
    kept = kept_bundle(folder)
    bundles[MODEL] = kept or trained_bundle(folder, job, outcome, source, dataset)
    return bundles


def trained_bundle(
    folder: Path,
    job: Job[PathTrainConfig],
    outcome: TrialOutcome,
    source: Bundle,
    dataset: Dataset,
) -> Bundle:
    """The bundle of one of a job's trials, which is named after its model."""
    train = job.config
    net = load_points(train.wgan, source.spec, outcome.checkpoint)
    graph, noise = point_graph(net, source.spec.latent_dim), RandomInput("noise", "normal", (net.noise_dim,))
    seeds = {"training": train.seed, "data": dataset.generator_seed}
    recipe = {"path_model": outcome.name, "source_digest": source.digest, **train.to_dict()}
    recipe |= {} if job.start_run_id is None else {TAG_START: job.start_run_id}
    metrics = {**outcome.metrics, "training_s": outcome.seconds}
    return write_path_bundle(folder, source, graph, (noise,), dataset.digest, seeds, recipe, metrics)


def _register(
    job: Job[PathTrainConfig], registry: ModelRegistry, model: str, name: str, bundle: Bundle
) -> int:
    tags = {
        "path_model": name,
        "data_digest": bundle.spec.provenance.data_digest or "",
        "preset": job.config.preset,
        "seed": str(job.config.seed),
    }
    tags |= {} if job.start_run_id is None else {TAG_START: job.start_run_id}
    version = registry.register(model, bundle.folder, job.child(name), bundle.digest, tags, alias=name)
    if name == MODEL:
        registry.set_alias(model, ALIAS_CHALLENGER, version.number)
    if name == UNTRAINED:
        # A run without a trial that would end it.
        with job.tracking.resume(job.child(name)) as run:
            run.params(dict(bundle.spec.provenance.config))
    job.tracking.note(job.child(name), tags={TAG_MODEL: str(version)})
    _LOG.info("registry: %s version %d, %s", model, version.number, name)
    return version.number
