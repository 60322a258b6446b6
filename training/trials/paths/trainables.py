"""The trials of path models: one function that Tune runs, and how a trained network is read back."""

from pathlib import Path
from typing import cast

import torch

from cspace.errors import JobError
from training.config.paths import PathModel, PathTrainConfig
from training.models.checkpoint import load_weights, seeded_initialisation, trained
from training.models.lookups.lookups import Scenes, make_lookups, make_reader, values_read
from training.models.modules import TrialModule
from training.models.paths.density import DensityModule
from training.models.paths.distillation import FlowDistillationModule
from training.models.paths.modules import (
    FlowModule,
    PathGanModule,
    PathVaeModule,
    make_path_generator,
    point_sizes,
)
from training.models.paths.points import PathDecoder, PathFlow, RefiningGenerator
from training.models.paths.settings import FlowConfig, PathGanConfig, PathVaeConfig, PointConfig
from training.models.paths.unet import CellGrid, PathUNet
from training.trials.paths.arrays import PathArrays
from training.trials.paths.guides import Guides
from training.trials.request import TrialRequest
from training.trials.tracked import fit_tracked


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
    fit_tracked(trial, module, getattr(train, name), train.resources, tracking_uri)


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
        return PathGanModule(config, samples, _scenes(config, arrays), seed, space)
    if guides is None:
        raise JobError("a guided model needs local critics", expected="guides", got="none")
    reader = make_reader(guides.lookups, arrays.scenes())
    return PathGanModule(config, samples, _scenes(config, arrays), seed, space, guides.critics(), reader)


def load_density(train: PathTrainConfig, arrays: PathArrays, checkpoint: Path) -> PathUNet:
    """The U-Net of a trial's checkpoint."""
    grid, config = CellGrid(arrays.world.space, train.density.cells), train.density
    return trained(lambda: PathUNet(grid, config.width, ways=config.ways), checkpoint, "net")


def load_points(
    name: PathModel, train: PathTrainConfig, arrays: PathArrays, checkpoint: Path
) -> PathFlow | PathDecoder | RefiningGenerator:
    """The flow, decoder or generator of a trial's checkpoint."""
    config = train.points_of(name)
    looked_up = values_read(make_lookups(config.lookups, arrays.world))
    sizes = point_sizes(config, arrays.world.space, arrays.mu.shape[1], looked_up)

    def fresh() -> PathFlow | PathDecoder | RefiningGenerator:
        if isinstance(config, FlowConfig):
            return PathFlow(sizes, config.evaluations, place=config.place)
        if isinstance(config, PathVaeConfig):
            return PathDecoder(sizes, config.code_dim, place=config.place)
        return make_path_generator(getattr(train, name), sizes)

    return trained(fresh, checkpoint, "net")


def _scenes(config: PointConfig, arrays: PathArrays) -> Scenes | None:
    return arrays.scenes() if config.lookups.wanted else None
