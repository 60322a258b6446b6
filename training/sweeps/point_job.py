"""One point of a sweep: its training job, and how good its bundle is on validation scenarios."""

import logging
import shlex
import time
from dataclasses import dataclass

from cspace.bundle import Bundle
from cspace.errors import CspaceError
from cspace.splits import Split
from services.evaluator.measures.scenes import Stage, measure_reconstruction
from services.planner.sources.local_sampler import BundleSampler
from services.registry.tracking.mlflow_tracking import MlflowTracking
from training.clusters.pipeline import train
from training.config.clusters import TrainConfig
from training.jobs.environment import Environment
from training.jobs.folders import job_folder
from training.jobs.patience import patiently
from training.sweeps.grid import Point
from training.sweeps.record import PointResult


@dataclass(frozen=True)
class PointJob:
    """A point's job, as its driver gets it; equal points are equal jobs.

    Args:
        point: which.
        config: of its training.
        overrides: that make it of its preset.
        environment: where it works.
        job: the name under which it goes on.
        parent_run_id: of the sweep.
        scenarios: validation scenarios that judge its bundle.
        register: whether the bundle becomes a version.
    """

    point: Point
    config: TrainConfig
    overrides: tuple[str, ...]
    environment: Environment
    job: str
    parent_run_id: str
    scenarios: int
    register: bool

    def __hash__(self) -> int:
        return hash(self.job)


def run_point(one: PointJob) -> PointResult:
    """Train and measure; an error of the project is a result, for the other points go on."""
    logging.getLogger("training").setLevel(logging.WARNING)
    began = time.monotonic()
    # What the bundle says of its origin: the command that would train this point alone.
    settings = [part for override in one.overrides for part in ("--set", shlex.quote(override))]
    command = " ".join(["python training/cluster_train.py --preset", one.config.preset, *settings])
    try:
        result = train(
            one.config,
            one.environment,
            one.job,
            parent_run_id=one.parent_run_id,
            register=one.register,
            command=command,
        )
        metrics = quality(one, result.run_id)
    except CspaceError as error:
        return PointResult("failed", time.monotonic() - began, {}, error=str(error))
    except KeyboardInterrupt:
        return PointResult("stopped", time.monotonic() - began, {}, error="asked to stop")
    return PointResult("finished", time.monotonic() - began, metrics, result.run_id)


def quality(one: PointJob, run_id: str) -> dict[str, float]:
    """Precision, coverage and EDr of the bundle on validation scenarios, logged with its run."""
    bundle = Bundle.load(job_folder(one.environment, run_id) / "bundle")
    stage = Stage(bundle.spec.world, Split.VALIDATION, 0)
    found = measure_reconstruction(stage, BundleSampler(bundle), one.scenarios).sampler
    metrics = {name: getattr(found, name).estimate for name in ("precision", "coverage", "edr")}
    tracking, patience_s = MlflowTracking(one.environment.tracking_uri), one.environment.patience_s
    with patiently("opening the point's run", lambda: tracking.resume(run_id), patience_s) as run:
        run.metrics({f"validation_{name}": value for name, value in metrics.items()}, 0)
    return metrics
