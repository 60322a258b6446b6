"""Checkpoints without pickle: tensors as safetensors, the rest as JSON, written beside and renamed."""

import contextlib
import json
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeVar

import torch
from safetensors import SafetensorError, safe_open
from safetensors.torch import load_file, save_file
from torch import Tensor, nn

from cspace.errors import ConfigError
from cspace.files import discard, replacing
from cspace.simulator import derived_seed
from cspace.world import World
from training.config import GridConfig
from training.models.grid_head import SceneModel
from training.models.modules import TrialModule

Network = TypeVar("Network", bound=nn.Module)

WEIGHTS, TRAINING, STATE = "weights.safetensors", "training.safetensors", "state.json"


@dataclass(frozen=True, slots=True)
class Progress:
    """Where a trial stands."""

    step: int
    run_id: str
    history: tuple[Mapping[str, float], ...] = ()


@contextlib.contextmanager
def seeded_initialisation(seed: int) -> Iterator[None]:
    """Initialise networks from ``seed`` and leave the global generator as it was.

    The draws of a module's training, which has the same seed, are others.
    """
    with torch.random.fork_rng(devices=[]):
        torch.random.manual_seed(derived_seed(seed, "initialisation"))
        yield


def save_checkpoint(folder: Path, module: TrialModule, progress: Progress) -> Path:
    """Weights, optimisers, schedules, the generator's state and the progress, as one folder."""
    tensors = {"rng": module.rng.get_state()}
    groups: list[Any] = []
    for index, optimiser in enumerate(module.training_optimisers):
        state = optimiser.state_dict()
        groups.append(state["param_groups"])
        for parameter, values in state["state"].items():
            tensors |= {f"{index}.{parameter}.{name}": value for name, value in values.items()}
    schedules = [_plain(schedule.state_dict()) for schedule in module.training_schedules]
    content = {
        "step": progress.step,
        "run_id": progress.run_id,
        "history": [dict(row) for row in progress.history],
        "groups": groups,
        "schedules": schedules,
    }
    with replacing(folder) as beside:
        beside.mkdir(parents=True)
        save_file(_contiguous(module.state_dict()), beside / WEIGHTS)
        save_file(_contiguous(tensors), beside / TRAINING)
        (beside / STATE).write_text(json.dumps(content), encoding="utf-8")
        discard(folder)
    return folder


def read_progress(folder: Path) -> Progress:
    """Where the trial of a checkpoint stood."""
    content = json.loads((folder / STATE).read_text(encoding="utf-8"))
    return Progress(int(content["step"]), str(content["run_id"]), tuple(content["history"]))


def load_checkpoint(folder: Path, module: TrialModule) -> None:
    """Fill ``module`` from :func:`save_checkpoint`'s folder."""
    content = json.loads((folder / STATE).read_text(encoding="utf-8"))
    module.load_state_dict(load_file(folder / WEIGHTS))
    tensors = load_file(folder / TRAINING)
    module.rng.set_state(tensors.pop("rng"))
    for index, optimiser in enumerate(module.training_optimisers):
        optimiser.load_state_dict(
            {"state": _optimiser_state(tensors, index), "param_groups": content["groups"][index]}
        )
    for schedule, state in zip(module.training_schedules, content["schedules"], strict=True):
        schedule.load_state_dict(state)


def start_from(folder: Path, module: TrialModule) -> None:
    """Give a new module the parameters that an earlier one has learned, and nothing else of its training.

    What follows from the data, and parameters that are not learned, stay as they are.
    """
    learned = load_file(folder / WEIGHTS)
    trained = [name for name, parameter in module.named_parameters() if parameter.requires_grad]
    module.load_state_dict({name: learned[name] for name in trained if name in learned}, strict=False)


def load_weights(folder: Path, prefix: str) -> dict[str, Tensor]:
    """The weights of one part of a checkpoint's module, such as ``generator``, without their prefix."""
    weights = load_file(folder / WEIGHTS)
    start = prefix + "."
    return {name.removeprefix(start): value for name, value in weights.items() if name.startswith(start)}


def trained(make: Callable[[], Network], folder: Path, part: str) -> Network:
    """A network with the weights of one part of a checkpoint's module, ready to be asked."""
    with seeded_initialisation(0):
        network = make()
    network.load_state_dict(load_weights(folder, part))
    return network.eval()


def save_scene_model(path: Path, model: SceneModel) -> None:
    """Write the weights of a scene model with its sizes as one file."""
    sizes = {"grid": model.config.model_dump(), "hidden": model.hidden, "voxel_m": model.voxel_m}
    with replacing(path, "the scene model") as beside:
        save_file(_contiguous(model.state_dict()), beside, {"sizes": json.dumps(sizes)})


def load_scene_model(path: Path, world: World) -> SceneModel:
    """The scene model of a file, for pictures of a world."""
    try:
        with safe_open(path, "pt") as file:
            sizes = json.loads(file.metadata()["sizes"])
        grid = GridConfig.model_validate(sizes["grid"])
        arm = world.grid_arm(grid.groups)
        model = SceneModel(grid, int(sizes["hidden"]), arm)
        model.load_state_dict(load_file(path))
    except (OSError, SafetensorError, TypeError, KeyError, ValueError, RuntimeError) as error:
        raise ConfigError(
            "the scene model cannot be read",
            expected="a file that python -m training.scene_model wrote",
            got=f"{path}: {str(error)[:300]}",
        ) from error
    if sizes["voxel_m"] != arm.voxel_m:
        raise ConfigError(
            "the scene model does not fit the arm's pictures",
            expected=f"voxels of {sizes['voxel_m']} m",
            got=f"{arm.voxel_m} m",
            remedy="train a head of its own with validity.scene_model=null",
        )
    return model.eval()


def _contiguous(tensors: dict[str, Tensor]) -> dict[str, Tensor]:
    return {name: tensor.detach().cpu().contiguous().clone() for name, tensor in tensors.items()}


def _optimiser_state(tensors: dict[str, Tensor], index: int) -> dict[int, dict[str, Tensor]]:
    state: dict[int, dict[str, Tensor]] = {}
    for key, value in tensors.items():
        owner, parameter, name = key.split(".", 2)
        if int(owner) == index:
            state.setdefault(int(parameter), {})[name] = value
    return state


def _plain(state: dict[str, Any]) -> dict[str, Any]:
    """A schedule's state without what JSON can not hold (functions, which the module makes again)."""
    kinds = (int, float, str, bool, list, type(None))
    return {
        key: value for key, value in state.items() if isinstance(value, kinds) and key != "lr_lambdas"
    } | ({"lr_lambdas": [None]} if "lr_lambdas" in state else {})
