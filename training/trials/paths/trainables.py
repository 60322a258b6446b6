"""The trials of path models: one function that Tune runs, and how a trained network is read back."""

from pathlib import Path
from typing import cast

from cspace.errors import JobError
from training.config.paths import PathModel, PathTrainConfig
from training.models.checkpoint import seeded_initialisation, trained
from training.models.lookups.lookups import Scenes, make_lookups, make_reader, values_read
from training.models.modules import TrialModule
from training.models.paths.modules import FlowModule, PathGanModule, point_sizes
from training.models.paths.points import PathFlow, PathGenerator
from training.models.paths.settings import FlowConfig, PathGanConfig, PointConfig
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
) -> None:
    """Train the path model that the trial is named after."""
    name = cast("PathModel", trial.name)
    with seeded_initialisation(trial.seed):
        module = make_path_module(name, train, arrays, trial.seed, guides)
    fit_tracked(trial, module, getattr(train, name), train.resources, tracking_uri)


def make_path_module(
    name: PathModel,
    train: PathTrainConfig,
    arrays: PathArrays,
    seed: int,
    guides: Guides | None = None,
) -> TrialModule:
    """A path model with its data, ready to be trained.

    Args:
        name: of the model.
        train: sizes and budgets.
        arrays: the data.
        seed: of every draw.
        guides: local critics, for the guided model.

    Raises:
        JobError: there are no guides for a guided model.
    """
    samples, space = arrays.samples(), arrays.world.space
    if name == "flow":
        return FlowModule(train.flow, samples, _scenes(train.flow, arrays), seed, space)
    config: PathGanConfig = getattr(train, name)
    if config.guide_weight == 0.0:
        return PathGanModule(config, samples, _scenes(config, arrays), seed, space)
    if guides is None:
        raise JobError("a guided model needs local critics", expected="guides", got="none")
    reader = make_reader(guides.lookups, arrays.scenes())
    return PathGanModule(config, samples, _scenes(config, arrays), seed, space, guides.critics(), reader)


def load_points(
    name: PathModel, train: PathTrainConfig, arrays: PathArrays, checkpoint: Path
) -> PathFlow | PathGenerator:
    """The flow or generator of a trial's checkpoint."""
    config = train.points_of(name)
    looked_up = values_read(make_lookups(config.lookups, arrays.world))
    sizes = point_sizes(config, arrays.world.space, arrays.mu.shape[1], looked_up)

    def fresh() -> PathFlow | PathGenerator:
        if isinstance(config, FlowConfig):
            return PathFlow(sizes, config.evaluations, place=config.place)
        return PathGenerator(sizes, getattr(train, name).noise_dim, place=config.place)

    return trained(fresh, checkpoint, "net")


def _scenes(config: PointConfig, arrays: PathArrays) -> Scenes | None:
    return arrays.scenes() if config.lookups.wanted else None
