"""The functions that Tune runs: make the module, hand it to :func:`fit`, report to Tune."""

import contextlib
import logging
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from ray import tune

from cspace.errors import JobError
from services.registry.mlflow_tracking import MlflowTracking
from training.config import TrainConfig
from training.models.cells import CellBase
from training.models.checkpoint import seeded_initialisation
from training.models.distillation import DistillationModule
from training.models.gate import GateModule
from training.models.joint import JointModule
from training.models.lookups import make_reader
from training.models.mixture import Experts
from training.models.modules import Metrics, TrialModule, VaeModule
from training.models.validity import ValidityModule
from training.trials.arrays import TrainingArrays
from training.trials.fit import Rhythm, fit
from training.trials.loading import fresh_generator, load_critic, load_generator, make_wgan, torus_generator
from training.trials.occupancy import OccupancyArrays

VAE, VALIDITY, GATE, GLOBAL, DISTILLED = "vae", "validity", "gate", "global", "distilled"


def picture_trial(
    config: Mapping[str, Any],
    train: TrainConfig,
    images: NDArray[np.uint8],
    occupancy: OccupancyArrays | None,
    tracking_uri: str,
) -> None:
    """Train what learns from (N, P, P, 3) pictures and needs no latents: the VAE, or the validity head."""
    trial = config["trial"]
    pictures = _channels_first(images)
    module: TrialModule
    with seeded_initialisation(trial["seed"]):
        if occupancy is not None and trial["name"] == VALIDITY:
            samples = occupancy.samples(pictures)
            module = ValidityModule(train.validity, samples, occupancy.robot, occupancy.camera, trial["seed"])
            steps = train.validity.steps
        else:
            module, steps = VaeModule(train.vae, pictures, trial["seed"]), train.vae.steps
    _fit(trial, module, steps, train, tracking_uri)


def gate_trial(
    config: Mapping[str, Any], train: TrainConfig, arrays: TrainingArrays, tracking_uri: str
) -> None:
    """Train the gate on the cells' shares of every scenario's free configurations."""
    trial = config["trial"]
    mu, sigma = torch.tensor(arrays.mu), torch.tensor(arrays.sigma)
    with seeded_initialisation(trial["seed"]):
        module = GateModule(train.gate, mu, sigma, arrays.shares(), trial["seed"])
    _fit(trial, module, train.gate.steps, train, tracking_uri)


def local_trial(
    config: Mapping[str, Any], train: TrainConfig, arrays: TrainingArrays, tracking_uri: str
) -> None:
    """Train one cluster's WGAN-GP (Algorithm 1)."""
    trial = config["trial"]
    module = make_wgan(train.local, arrays, trial["cluster"], trial["seed"])
    _fit(trial, module, train.local.steps, train, tracking_uri)


def global_trial(
    config: Mapping[str, Any],
    train: TrainConfig,
    arrays: TrainingArrays,
    local_checkpoints: list[str],
    tracking_uri: str,
) -> None:
    """Train the global WGAN-GP on all data, guided by the frozen local critics (eq. multiDirector)."""
    trial = config["trial"]
    critics = [load_critic(train.local, arrays, Path(folder)) for folder in local_checkpoints]
    weight = train.global_.local_critic_weight
    module = make_wgan(train.global_, arrays, None, trial["seed"], critics, weight)
    _fit(trial, module, train.global_.steps, train, tracking_uri)


def distillation_trial(
    config: Mapping[str, Any],
    train: TrainConfig,
    arrays: TrainingArrays,
    local_checkpoints: list[str],
    tracking_uri: str,
) -> None:
    """Train one generator to answer as the local ones do, each in its own cells."""
    trial = config["trial"]
    cells, base = arrays.cells, arrays.base(None)
    if cells is None or not isinstance(base, CellBase):
        raise JobError("a mixture to distil needs a gate", expected="gate.cells above 0", got="none")
    teachers = [
        torus_generator(load_generator(train.local, arrays, Path(folder))) for folder in local_checkpoints
    ]
    with seeded_initialisation(trial["seed"]):
        student = torus_generator(fresh_generator(train.global_, arrays))
        module = DistillationModule(
            train.global_,
            arrays.samples(None),
            Experts(teachers, torch.tensor(cells.clusters)),
            make_reader(train.local.generator_lookups, arrays.scenes()),
            student,
            make_reader(train.global_.generator_lookups, arrays.scenes()),
            base,
            trial["seed"],
        )
    _fit(trial, module, train.global_.steps, train, tracking_uri)


def joint_trial(
    config: Mapping[str, Any],
    train: TrainConfig,
    arrays: TrainingArrays,
    images: NDArray[np.uint8],
    tracking_uri: str,
) -> None:
    """Train one WGAN-GP on all data together with the encoder of (S, P, P, 3) pictures."""
    trial = config["trial"]
    with seeded_initialisation(trial["seed"]):
        module = JointModule(
            train.global_,
            train.vae,
            arrays.samples(None),
            _channels_first(images),
            arrays.scale,
            trial["seed"],
        )
    _fit(trial, module, train.global_.steps, train, tracking_uri)


def _channels_first(images: NDArray[np.uint8]) -> torch.Tensor:
    return torch.tensor(np.ascontiguousarray(images.transpose(0, 3, 1, 2)))


def _fit(
    trial: Mapping[str, Any], module: TrialModule, steps: int, train: TrainConfig, tracking_uri: str
) -> None:
    # One thread a process: two torch pools on two cores are slower than one thread each.
    torch.set_num_threads(1)
    logging.basicConfig(level=logging.WARNING, format="%(message)s", force=True)
    logging.getLogger("training").setLevel(logging.INFO)
    for library in ("lightning.pytorch", "ray.train", "ray.tune"):
        logging.getLogger(library).setLevel(logging.ERROR)
    rhythm = Rhythm(train.resources.log_every_steps, train.resources.checkpoint_every_steps)
    run = MlflowTracking(tracking_uri).resume(trial["run_id"])
    with _checkpoint() as folder:
        fit(trial["name"], module, steps, rhythm, run, _report, folder)


def _report(metrics: Metrics, folder: Path | None) -> None:
    checkpoint = None if folder is None else tune.Checkpoint.from_directory(str(folder))
    tune.report(metrics, checkpoint=checkpoint)


@contextlib.contextmanager
def _checkpoint() -> Iterator[Path | None]:
    checkpoint = tune.get_checkpoint()
    if checkpoint is None:
        yield None
        return
    with checkpoint.as_directory() as folder:
        yield Path(folder)
