"""What the workers of the main job train: from pictures, and what a model family trains from latents."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray

from training.config import TrainConfig, TrialSettings
from training.models.autoencoders import VaeModule
from training.models.checkpoint import seeded_initialisation
from training.models.data import TrainingArrays
from training.models.families import Family
from training.models.modules import TrialModule
from training.trials.arrays import head_module
from training.trials.fit import fit_tracked
from training.trials.launch import TrialRequest

VAE, VALIDITY = "vae", "validity"


def picture_trial(
    trial: TrialRequest,
    train: TrainConfig,
    images: NDArray[np.uint8],
    data_folder: Path,
) -> None:
    """Train what learns from pictures, channels first, and needs no latents: the VAE, or the head."""
    pictures = torch.tensor(images)
    module: TrialModule
    settings: TrialSettings
    with seeded_initialisation(trial.seed):
        if trial.name == VALIDITY:
            module = head_module(data_folder, train.validity, pictures, trial.seed, train.data.outcomes)
            settings = train.validity
        else:
            module, settings = VaeModule(train.vae, pictures, trial.seed), train.vae
    fit_tracked(trial, module, settings, train.resources, pictures=len(images))


def family_trial(
    trial: TrialRequest,
    kind: type[Family[Any]],
    train: TrainConfig,
    arrays: TrainingArrays,
    done: Mapping[str, Path],
) -> None:
    """Train one trial of a model family; ``done`` holds the checkpoints of the stages before."""
    with seeded_initialisation(trial.seed):
        made = kind(train, arrays).trial(trial.name, trial.seed, done)
    fit_tracked(trial, made.module, made.settings, train.resources, **made.parameters)
