"""The functions that Tune runs: make the module, hand it to :func:`fit`, report to Tune."""

import contextlib
import logging
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from ray import tune

from services.registry.mlflow_tracking import MlflowTracking
from training.config import GanConfig, TrainConfig
from training.models.checkpoint import load_weights, seeded_initialisation
from training.models.data import ScenarioSamples
from training.models.joint import JointModule
from training.models.modules import Metrics, TrialModule, VaeModule, WganGpModule, make_critic
from training.models.networks import Critic
from training.models.validity import ValidityModule
from training.trials.fit import Rhythm, fit
from training.trials.occupancy import OccupancyArrays

VAE, VALIDITY = "vae", "validity"


@dataclass(frozen=True, slots=True)
class TrainingArrays:
    """What every WGAN-GP trial reads, shared through the object store.

    Args:
        configurations: (M, d) float32 rad.
        ids: (M,) int64 scenario of each configuration.
        labels: (M,) int64 cluster of each configuration.
        mu: (S, L) float32 latent means.
        sigma: (S, L) float32 latent standard deviations.
    """

    configurations: NDArray[np.float32]
    ids: NDArray[np.int64]
    labels: NDArray[np.int64]
    mu: NDArray[np.float32]
    sigma: NDArray[np.float32]

    @property
    def scale(self) -> tuple[torch.Tensor, torch.Tensor]:
        """Mean and standard deviation of all configurations, each (d,) rad."""
        return scale_of(self.configurations)

    def samples(self, cluster: int | None) -> ScenarioSamples:
        """The configurations of one cluster, or all of them; copied, for the shared ones are read-only."""
        rows = slice(None) if cluster is None else np.flatnonzero(self.labels == cluster)
        return ScenarioSamples(
            *(
                torch.tensor(array)
                for array in (self.configurations[rows], self.ids[rows], self.mu, self.sigma)
            )
        )


def scale_of(configurations: NDArray[np.float32]) -> tuple[torch.Tensor, torch.Tensor]:
    """Mean and standard deviation of (M, d) configurations, each (d,) rad."""
    return torch.tensor(configurations.mean(axis=0)), torch.tensor(configurations.std(axis=0))


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


def local_trial(
    config: Mapping[str, Any], train: TrainConfig, arrays: TrainingArrays, tracking_uri: str
) -> None:
    """Train one cluster's WGAN-GP (Algorithm 1)."""
    trial = config["trial"]
    with seeded_initialisation(trial["seed"]):
        module = WganGpModule(train.local, arrays.samples(trial["cluster"]), arrays.scale, trial["seed"])
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
    samples, scale = arrays.samples(None), arrays.scale
    critics = [_frozen_critic(train.local, samples, scale, Path(folder)) for folder in local_checkpoints]
    with seeded_initialisation(trial["seed"]):
        weight = train.global_.local_critic_weight
        module = WganGpModule(train.global_, samples, scale, trial["seed"], critics, weight)
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


def _frozen_critic(
    config: GanConfig, samples: ScenarioSamples, scale: tuple[torch.Tensor, torch.Tensor], folder: Path
) -> Critic:
    dim, latent_dim = samples.configurations.shape[1], samples.mu.shape[1]
    with seeded_initialisation(0):
        critic = make_critic(config, dim, latent_dim, len(samples.mu), scale)
    critic.load_state_dict(load_weights(folder, "critic"))
    return critic


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
