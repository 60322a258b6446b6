"""The main job: data, clusters, VAE and validity head, gate, local trials, global trial, bundle, registry."""

import logging
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from cspace.bundle import Bundle
from cspace.dataset import Dataset
from services.names import ALIAS_CHALLENGER, recorded_name
from services.registry.models.mlflow_registry import MlflowRegistry
from services.registry.tracking.experiment import TAG_MODEL
from services.results import numbers
from training.clusters.bundling import TrainedParts, make_bundle
from training.clusters.reporting import log_result, log_start
from training.clusters.stages import (
    cluster_data,
    encode_data,
    encoder_checkpoint,
    prepare_data,
    require_encoder,
    train_gate,
    train_global,
    train_local,
    train_on_pictures,
)
from training.config.clusters import TrainConfig
from training.jobs.environment import Environment
from training.jobs.job import TAG_START, Job, kept_bundle
from training.jobs.labels import world_tag
from training.jobs.naming import registered_name
from training.jobs.provenance import job_tags
from training.trials.launch import connect
from training.trials.outcomes import TrialOutcome

_LOG = logging.getLogger("training")
BUNDLE_FOLDER = "bundle"


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

    def rows(self, folder: Path) -> dict[str, str]:
        """The lines of a block for people; the job lies in ``folder``."""
        return {
            "model": f"{self.model}/{self.version}",
            "run": self.run_id,
            "trials": numbers({name: end - start for name, (start, end) in self.trials.items()}, " s"),
            "last metrics": numbers(self.metrics),
            "data": self.data_digest,
            "bundle": str(folder / BUNDLE_FOLDER),
        }


def train(config: TrainConfig, environment: Environment, name: str | None = None) -> TrainResult:
    """Run the whole job, or go on with the one that was submitted under this name before.

    Args:
        config: what it trains.
        environment: where it works.
        name: of the job; None always starts a new one.

    Raises:
        CspaceError: bad data, a failed trial, a registry that does not answer, or a name that belongs to a
            job of other settings.
        KeyboardInterrupt: it was asked to stop; it can be resumed.
    """
    connect()
    tags = job_tags(config.preset, config.seed, "training/cluster_train.py")
    return _run(Job.start(config, environment, tags, name=name))


def resume(run_id: str, environment: Environment) -> TrainResult:
    """Go on with a job that was stopped: finished trials stay, others start from their checkpoints.

    Args:
        run_id: the job's parent run.
        environment: the same as the job's.

    Raises:
        CspaceError: as for :func:`train`; ConfigError where there is no such job.
    """
    connect()
    return _run(Job.resume(run_id, environment, TrainConfig))


def _run(job: Job[TrainConfig]) -> TrainResult:
    with job.running() as run:
        dataset = prepare_data(job.config, job.environment.data_folder)
        # The configuration's name for the robot, else that of its data.
        config = job.config
        if config.robot_name is None:
            config = config.model_copy(update={"robot_name": recorded_name(dataset.manifest.generator)})
        model = registered_name(job, dataset.world, config.robot_name, path=False)
        log_start(run, job.config, dataset)
        job.tell(world_tag(dataset.world, config.robot_name))
        require_encoder(job, dataset)
        data = cluster_data(job, dataset)
        vae, head = train_on_pictures(job, dataset)
        arrays, gate = train_gate(job, encode_data(job, dataset, vae, data))
        local = train_local(job, arrays)
        final = train_global(job, dataset, arrays, local)
        _LOG.info("bundle: exporting")
        generators = tuple(outcome.checkpoint for outcome in final or local)
        encoder = generators[0] if job.config.joint else encoder_checkpoint(job, vae)
        gate_at, head_at = _checkpoint(gate), _checkpoint(head)
        parts = TrainedParts(encoder, generators, gate_at, head_at, arrays, job.start_run_id)
        bundle = kept_bundle(job.folder / BUNDLE_FOLDER)
        if bundle is None:
            bundle = make_bundle(job.folder / BUNDLE_FOLDER, config, dataset, parts)
        outcomes = [outcome for outcome in (vae, head, gate, *local, *final) if outcome is not None]
        figures = log_result(run, bundle, dataset, outcomes)
        version = _register(job, model, dataset, bundle)
    return TrainResult(
        run_id=job.run.run_id,
        model=model,
        version=version,
        digest=bundle.digest,
        data_digest=dataset.digest,
        metrics=outcomes[-1].metrics,
        trials={outcome.name: (outcome.started_s, outcome.ended_s) for outcome in outcomes},
        figures=figures,
    )


def _checkpoint(outcome: TrialOutcome | None) -> Path | None:
    return None if outcome is None else outcome.checkpoint


def _register(job: Job[TrainConfig], model: str, dataset: Dataset, bundle: Bundle) -> int:
    registry = MlflowRegistry(job.environment.tracking_uri)
    tags = {"data_digest": dataset.digest, "preset": job.config.preset, "seed": str(job.config.seed)}
    tags |= {} if job.start_run_id is None else {TAG_START: job.start_run_id}
    version = job.patiently(
        "registering the bundle",
        lambda: registry.register(
            model, bundle.folder, job.run.run_id, bundle.digest, tags, alias=ALIAS_CHALLENGER
        ),
    )
    job.tell({TAG_MODEL: str(version)})
    _LOG.info("registry: %s version %d, alias %s", model, version.number, ALIAS_CHALLENGER)
    return version.number
