"""The functions that Tune runs: make the module, hand it to :func:`fit`, report to Tune."""

from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray

from cspace.errors import JobError
from training.config.clusters import TrainConfig
from training.models.cells import CellBase
from training.models.checkpoint import seeded_initialisation
from training.models.distillation import DistillationModule
from training.models.gate import GateModule
from training.models.joint import JointModule
from training.models.lookups.lookups import make_reader
from training.models.mixture import Experts
from training.models.modules import TrialModule, VaeModule
from training.trials.arrays import TrainingArrays
from training.trials.grid_occupancy import GridOccupancy
from training.trials.loading import fresh_generator, load_critic, load_generator, make_wgan, torus_generator
from training.trials.occupancy import OccupancyArrays
from training.trials.request import TrialRequest
from training.trials.tracked import TrialSettings, fit_tracked

VAE, VALIDITY, GATE, GLOBAL, DISTILLED = "vae", "validity", "gate", "global", "distilled"


def picture_trial(
    trial: TrialRequest,
    train: TrainConfig,
    images: NDArray[np.uint8],
    occupancy: OccupancyArrays | GridOccupancy | None,
    tracking_uri: str,
) -> None:
    """Train what learns from pictures, channels first, and needs no latents: the VAE, or the head."""
    pictures = torch.tensor(images)
    module: TrialModule
    settings: TrialSettings
    with seeded_initialisation(trial.seed):
        if occupancy is not None and trial.name == VALIDITY:
            module, settings = occupancy.module(train.validity, pictures, trial.seed), train.validity
        else:
            module, settings = VaeModule(train.vae, pictures, trial.seed), train.vae
    fit_tracked(trial, module, settings, train.resources, tracking_uri, pictures=len(images))


def gate_trial(trial: TrialRequest, train: TrainConfig, arrays: TrainingArrays, tracking_uri: str) -> None:
    """Train the gate on the cells' shares of every scenario's free configurations."""
    mu, sigma = torch.tensor(arrays.mu), torch.tensor(arrays.sigma)
    with seeded_initialisation(trial.seed):
        module = GateModule(train.gate, mu, sigma, arrays.shares(), trial.seed)
    fit_tracked(trial, module, train.gate, train.resources, tracking_uri)


def local_trial(trial: TrialRequest, train: TrainConfig, arrays: TrainingArrays, tracking_uri: str) -> None:
    """Train one cluster's WGAN-GP (Algorithm 1)."""
    module = make_wgan(train.local, arrays, trial.cluster, trial.seed)
    part = arrays.part(trial.cluster)
    fit_tracked(trial, module, train.local, train.resources, tracking_uri, **part)


def global_trial(
    trial: TrialRequest,
    train: TrainConfig,
    arrays: TrainingArrays,
    local_checkpoints: list[str],
    tracking_uri: str,
) -> None:
    """Train the global WGAN-GP on all data, guided by the frozen local critics (eq. multiDirector)."""
    critics = [load_critic(train.local, arrays, Path(folder)) for folder in local_checkpoints]
    weight = train.global_.local_critic_weight
    module = make_wgan(train.global_, arrays, None, trial.seed, critics, weight)
    fit_tracked(trial, module, train.global_, train.resources, tracking_uri)


def distillation_trial(
    trial: TrialRequest,
    train: TrainConfig,
    arrays: TrainingArrays,
    local_checkpoints: list[str],
    tracking_uri: str,
) -> None:
    """Train one generator to answer as the local ones do, each in its own cells."""
    cells, base = arrays.cells, arrays.base(None)
    if cells is None or not isinstance(base, CellBase):
        raise JobError("a mixture to distil needs a gate", expected="gate.cells above 0", got="none")
    teachers = [
        torus_generator(load_generator(train.local, arrays, Path(folder))) for folder in local_checkpoints
    ]
    with seeded_initialisation(trial.seed):
        student = torus_generator(fresh_generator(train.global_, arrays))
        module = DistillationModule(
            train.global_,
            arrays.samples(None),
            Experts(teachers, torch.tensor(cells.clusters)),
            make_reader(train.local.generator_lookups, arrays.scenes()),
            student,
            make_reader(train.global_.generator_lookups, arrays.scenes()),
            base,
            trial.seed,
        )
    fit_tracked(trial, module, train.global_, train.resources, tracking_uri)


def joint_trial(
    trial: TrialRequest,
    train: TrainConfig,
    arrays: TrainingArrays,
    images: NDArray[np.uint8],
    tracking_uri: str,
) -> None:
    """Train one WGAN-GP on all data together with the encoder of (S, P, P, 3) pictures."""
    with seeded_initialisation(trial.seed):
        module = JointModule(
            train.global_,
            train.vae,
            arrays.samples(None),
            _channels_first(images),
            arrays.scale,
            trial.seed,
            arrays.world.space,
        )
    fit_tracked(trial, module, train.global_, train.resources, tracking_uri)


def _channels_first(images: NDArray[np.uint8]) -> torch.Tensor:
    return torch.tensor(np.ascontiguousarray(images.transpose(0, 3, 1, 2)))
