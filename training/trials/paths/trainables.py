"""The trials of path models: one function that Tune runs, and how a trained network is read back."""

from collections.abc import Callable
from pathlib import Path
from typing import Any, cast

import torch

from cspace.errors import JobError
from training.config.paths import PathModel, PathTrainConfig
from training.models.checkpoint import load_weights, seeded_initialisation
from training.models.lookups.lookups import make_reader
from training.models.modules import TrialModule
from training.models.paths.density import DensityModule
from training.models.paths.distillation import FlowDistillationModule
from training.models.paths.modules import (
    FlowModule,
    PathGanModule,
    PathVaeModule,
    make_flow,
    make_path_generator,
)
from training.models.paths.points import PathDecoder, PathFlow, RefiningGenerator
from training.models.paths.settings import FlowConfig, PathGanConfig, PointConfig
from training.models.paths.unet import CellGrid, PathUNet
from training.trials.paths.arrays import PathArrays
from training.trials.paths.guides import Guides
from training.trials.request import TrialRequest
from training.trials.tracked import fit_tracked

Maker = Callable[[PathTrainConfig, PathArrays, int, Guides | None], TrialModule]


def path_trial(
    trial: TrialRequest,
    train: PathTrainConfig,
    arrays: PathArrays,
    guides: Guides | None,
    tracking_uri: str,
    teacher: Path | None = None,
) -> None:
    """Train the path model that the trial is named after."""
    name = cast("PathModel", trial.name)
    with seeded_initialisation(trial.seed):
        module = make_path_module(name, train, arrays, trial.seed, guides, teacher)
    steps = getattr(train, name).steps
    fit_tracked(trial, module, steps, train.resources, tracking_uri)


def make_path_module(
    name: PathModel,
    train: PathTrainConfig,
    arrays: PathArrays,
    seed: int,
    guides: Guides | None = None,
    teacher: Path | None = None,
) -> TrialModule:
    """A path model with its data, ready to be trained.

    Args:
        name: of the model.
        train: sizes and budgets.
        arrays: the data.
        seed: of every draw.
        guides: local critics, for the guided model.
        teacher: the flow's checkpoint, for the distilled one.

    Raises:
        JobError: the arrays have no maps for a density, or there are no guides for a guided model, or no
            teacher for a distilled one.
    """
    samples, space = arrays.samples(), arrays.world.space
    if name == "density":
        if arrays.maps is None:
            raise JobError("a density needs the maps of the validity head", expected="maps", got="none")
        fields = None if arrays.fields is None or not train.density.ways else torch.tensor(arrays.fields)
        return DensityModule(train.density, samples, torch.tensor(arrays.maps), fields, space, seed)
    if name == "flow":
        return FlowModule(train.flow, samples, _scenes(train.flow, arrays), seed, space)
    if name == "flow_distilled":
        if teacher is None:
            raise JobError("a distilled flow needs a teacher", expected="the flow's checkpoint", got="none")
        weights, scenes = load_weights(teacher, "net"), _scenes(train.flow, arrays)
        return FlowDistillationModule(train.flow_distilled, train.flow, samples, scenes, weights, seed, space)
    if name == "cvae":
        return PathVaeModule(train.cvae, samples, _scenes(train.cvae, arrays), seed, space)
    config: PathGanConfig = getattr(train, name)
    if config.guide_weight == 0.0:
        return PathGanModule(config, samples, _scenes(config, arrays), seed, space=space)
    if guides is None:
        raise JobError("a guided model needs local critics", expected="guides", got="none")
    reader = make_reader(guides.lookups, arrays.scenes())
    return PathGanModule(config, samples, _scenes(config, arrays), seed, guides.critics(), reader, space)


def load_density(train: PathTrainConfig, arrays: PathArrays, checkpoint: Path) -> PathUNet:
    """The U-Net of a trial's checkpoint."""
    with seeded_initialisation(0):
        grid = CellGrid(arrays.world.space, train.density.cells)
        net = PathUNet(grid, train.density.width, ways=train.density.ways)
    net.load_state_dict(load_weights(checkpoint, "net"))
    return net.eval()


def load_points(
    name: PathModel, train: PathTrainConfig, arrays: PathArrays, checkpoint: Path
) -> PathFlow | PathDecoder | RefiningGenerator:
    """The flow, decoder or generator of a trial's checkpoint."""
    dim, latent_dim, space = arrays.paths.shape[2], arrays.mu.shape[1], arrays.world.space
    config = train.points_of(name)
    reader = make_reader(config.lookups, _scenes(config, arrays))
    looked_up = 0 if reader is None else reader.lookups.values
    net: PathFlow | PathDecoder | RefiningGenerator
    with seeded_initialisation(0):
        if isinstance(config, FlowConfig):
            net = make_flow(config, dim, latent_dim, looked_up, space)
        elif name == "cvae":
            sizes = (dim, latent_dim, train.cvae.hidden, train.cvae.layers, train.cvae.code_dim)
            net = PathDecoder(*sizes, 0, place=train.cvae.place, space=space)
        else:
            net = make_path_generator(getattr(train, name), dim, latent_dim, looked_up, space)
    net.load_state_dict(load_weights(checkpoint, "net"))
    return net.eval()


def _scenes(config: PointConfig, arrays: PathArrays) -> Any:
    return arrays.scenes() if config.lookups.points_per_link else None
