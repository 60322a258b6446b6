"""What the workers of the main job train: from pictures, and what a model family trains from latents."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray

from cspace.dataset import Dataset, open_dataset
from cspace.worlds import simulator_of
from training.config import GridConfig, HeadConfig, TrainConfig, TrialSettings, ValidityConfig
from training.jobs.fit import fit_tracked
from training.jobs.launch import TrialRequest
from training.models.autoencoders import VaeModule
from training.models.checkpoint import load_scene_model, seeded_initialisation
from training.models.data import TrainingArrays
from training.models.families import Family
from training.models.grid_training import ArmSamples, GridHeadModule, GridSamples
from training.models.modules import TrialModule
from training.models.validity import OccupancySamples, ValidityModule

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


def has_occupancy(dataset: Dataset, config: ValidityConfig) -> bool:
    """Whether a head can learn from a data set: along links it needs scenarios with both kinds."""
    if dataset.collision is None:
        return False
    return config.grid is not None or len(_with_both_kinds(dataset)) > 0


def head_module(
    folder: Path, config: HeadConfig, images: torch.Tensor, seed: int, outcomes: Path | None = None
) -> TrialModule:
    """The training of a validity head."""
    dataset = open_dataset(folder, verify=False)
    if config.grid is None:
        return ValidityModule(config, occupancy_samples(dataset, images), dataset.world, seed)
    file, grid = config.scene_model_file, config.grid
    start = None if file is None else load_scene_model(file, dataset.world)
    if start is not None:
        grid = start.config
        config = config.model_copy(update={"grid": grid, "hidden": start.hidden})
    sets = [dataset, *([] if outcomes is None else [open_dataset(outcomes, verify=False)])]
    held = ArmSamples(tuple(one.world for one in sets), tuple(grid_samples(one, grid) for one in sets))
    module = GridHeadModule(config, held, seed)
    if start is not None:
        module.head.model.load_state_dict(start.state_dict())
    return module


def occupancy_samples(dataset: Dataset, images: torch.Tensor) -> OccupancySamples:
    """Free and colliding configurations by scenario; copied, for those of the data set are read-only.

    ``images`` (S, 3, P, P) uint8, and further ones behind them that have no configurations.
    """
    names = ("free", "free_offsets", "collision", "collision_offsets")
    arrays = [*(dataset.arrays[name] for name in names), _with_both_kinds(dataset)]
    tensors = (torch.tensor(np.asarray(array)) for array in arrays)
    return OccupancySamples(images[: dataset.scenario_count], *tensors)


def _with_both_kinds(dataset: Dataset) -> NDArray[np.int64]:
    """Scenarios with free configurations and with some in collision."""
    counts = [np.diff(dataset.arrays[f"{kind}_offsets"]) for kind in ("free", "collision")]
    return np.flatnonzero((counts[0] > 0) & (counts[1] > 0))


def grid_samples(dataset: Dataset, config: GridConfig) -> GridSamples:
    """Pictures as they lie on disk; labelled configurations, and what they hit where obstacles are known."""
    rows, free, hits = [], [], []
    for scenario in range(dataset.scenario_count):
        sides = (np.asarray(dataset.free_of(scenario)), np.asarray(dataset.collision_of(scenario)))
        rows.append(np.concatenate(sides))
        free.append(np.repeat([True, False], [len(side) for side in sides]))
        hits.append(_hits(dataset, scenario, rows[-1], config.groups))
    offsets = np.cumsum([0, *(len(one) for one in rows)], dtype=np.int64)
    return GridSamples(
        dataset.images,
        torch.from_numpy(np.concatenate(rows)),
        torch.from_numpy(np.concatenate(free)),
        torch.from_numpy(np.concatenate(hits)),
        torch.from_numpy(offsets),
    )


def _hits(dataset: Dataset, scenario: int, rows: NDArray[np.float32], groups: int) -> NDArray[np.bool_]:
    names = dataset.world.scene_files
    if not set(names) <= set(dataset.arrays):
        return np.zeros((len(rows), 0), dtype=np.bool_)
    scene = {name: np.asarray(dataset.arrays[name][scenario]) for name in names}
    simulator: Any = simulator_of(dataset.world)
    found: NDArray[np.bool_] = simulator.group_hits(scene, rows, groups)
    return found
