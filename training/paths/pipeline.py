"""The job of path models: data, what a bundle sees of them, one trial a model, bundles, registry."""

import logging
from collections.abc import Mapping
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from cspace.bundle import Bundle
from cspace.dataset import Dataset, open_dataset
from services.commands import numbers
from services.names import ALIAS_CHALLENGER, TAG_MODEL, recorded_name
from services.registry.models import ModelRegistry
from training.config import PathTrainConfig
from training.data.generate import generate
from training.jobs.job import TAG_START, Job, kept_bundle, registered_name, world_tag
from training.paths.bundling import trained_bundle
from training.paths.writing import made_or_found, require_source, source_bundle
from training.trials.launch import TrialOutcome, TrialRequest, run_trials
from training.trials.paths import Guides, PathArrays, find_guides, path_arrays, path_trial, require_world

_LOG = logging.getLogger("training")

# The sampler that is not trained on paths, registered beside those that are.
UNTRAINED = "ways"


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
        guides = None if config.guides is None else find_guides(config.guides, source.digest)
        dataset = _data(config, job.environment.data_folder)
        job.log_configuration()
        run.dataset(dataset.folder.name, dataset.digest, str(dataset.folder), "training")
        job.add_tags(world_tag(source.spec.world, named))
        arrays = path_arrays(source, dataset, config.points)
        outcomes = _train(job, dataset, arrays, guides)
        run.flush()
        bundles = _bundles(job, source, dataset, arrays, outcomes)
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
            seconds={outcome.name: outcome.seconds for outcome in outcomes},
        )


def _data(config: PathTrainConfig, folder: Path) -> Dataset:
    if config.data_folder is not None:
        return open_dataset(config.data_folder)
    return generate(config.data, folder / "datasets" / f"paths-{config.data.folder_name}")


def _train(
    job: Job[PathTrainConfig], dataset: Dataset, arrays: PathArrays, guides: Guides | None
) -> list[TrialOutcome]:
    config = job.config
    trials = [TrialRequest.of(job, "models", name) for name in config.models]
    _LOG.info("path models: %s on %d paths", ", ".join(config.models), len(arrays.ids))
    shared: dict[str, Any] = {
        "train": config,
        "arrays": arrays,
        "guides": guides,
        "images": None if guides is None else np.asarray(dataset.images),
    }
    return run_trials(path_trial, trials, shared, config.resources)


def _bundles(
    job: Job[PathTrainConfig],
    source: Bundle,
    dataset: Dataset,
    arrays: PathArrays,
    outcomes: list[TrialOutcome],
) -> dict[str, Bundle]:
    """The untrained sampler's bundle, where the source has a head for it, and those of all trials."""
    bundles: dict[str, Bundle] = {}
    if source.has_validity:
        bundles[UNTRAINED] = made_or_found(source, job.folder / "bundles" / UNTRAINED)
    for name, outcome in zip(job.config.models, outcomes, strict=True):
        _LOG.info("bundle: exporting %s", name)
        folder = job.folder / "bundles" / name
        kept = kept_bundle(folder)
        if kept is None:
            kept = trained_bundle(folder, job, outcome, arrays, source, dataset)
        bundles[name] = kept
    return bundles


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
    version = registry.register(
        model, bundle.folder, job.child(name), bundle.digest, tags, alias=name.replace("_", "-")
    )
    if name == job.config.models[0]:
        registry.set_alias(model, ALIAS_CHALLENGER, version.number)
    if name == UNTRAINED:
        # A run without a trial that would end it.
        with job.tracking.resume(job.child(name)) as run:
            run.params(dict(bundle.spec.provenance.config))
    job.tracking.note(job.child(name), tags={TAG_MODEL: str(version)})
    _LOG.info("registry: %s version %d, %s", model, version.number, name)
    return version.number
