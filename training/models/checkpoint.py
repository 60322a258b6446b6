"""Training by Lightning from and to its checkpoints, what is read of them, and files of scene models."""

import contextlib
import json
import warnings
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any, TypeVar

import lightning
import torch
from lightning.fabric.plugins import TorchCheckpointIO
from lightning.pytorch.callbacks import ModelCheckpoint, ProgressBar
from safetensors import SafetensorError, safe_open
from safetensors.torch import load_file, save_file
from torch import Tensor, nn

from cspace.errors import ConfigError
from cspace.files import replacing
from cspace.simulator import derived_seed
from cspace.world import World
from training.config import GridConfig
from training.models.grid_head import SceneModel

Network = TypeVar("Network", bound=nn.Module)


@contextlib.contextmanager
def seeded_initialisation(seed: int) -> Iterator[None]:
    """Initialise networks from ``seed`` and leave the global generator as it was.

    The draws of a module's training, which has the same seed, are others.
    """
    with torch.random.fork_rng(devices=[]):
        torch.random.manual_seed(derived_seed(seed, "initialisation"))
        yield


class AtomicCheckpoints(TorchCheckpointIO):
    """Lightning's checkpoints, written beside and renamed.

    Lightning's own way copies from the folder of temporary files, which may be another disk: a process that
    is killed then leaves half a file.
    """

    def save_checkpoint(
        self, checkpoint: dict[str, Any], path: str | Path, storage_options: Any | None = None
    ) -> None:
        """Save as a file of tensors and plain values."""
        del storage_options
        Path(path).parent.mkdir(parents=True, exist_ok=True)
        with replacing(Path(path)) as beside:
            torch.save(checkpoint, beside)


def fit_module(
    module: lightning.LightningModule,
    steps: int,
    last: Path | None = None,
    callbacks: Sequence[lightning.Callback] = (),
) -> None:
    """Train up to a number of steps, from the checkpoint ``last`` on where it is there."""
    saves, shows = (
        any(isinstance(one, kind) for one in callbacks) for kind in (ModelCheckpoint, ProgressBar)
    )
    with warnings.catch_warnings():
        # Lightning counsels on loaders, loggers, and checkpoints of manual optimisation.
        warnings.simplefilter("ignore")
        trainer = lightning.Trainer(
            accelerator="auto",
            devices=1,
            max_steps=steps,
            logger=False,
            enable_checkpointing=saves,
            enable_progress_bar=shows,
            enable_model_summary=False,
            callbacks=list(callbacks),
            plugins=[AtomicCheckpoints()],
        )
        found = last if last is not None and last.is_file() else None
        # The modules draw their own batches, on their own device.
        loader: Any = range(steps)
        trainer.fit(module, loader, ckpt_path=found, weights_only=True)


def read_checkpoint(path: Path) -> dict[str, Any]:
    """A checkpoint of Lightning on the CPU; ``history`` are the metrics of a trial up to there."""
    content: dict[str, Any] = torch.load(path, map_location="cpu", weights_only=True)
    return content


def load_weights(path: Path, prefix: str) -> dict[str, Tensor]:
    """The weights of one part of a checkpoint's module, such as ``generator``, without their prefix."""
    weights, start = read_checkpoint(path)["state_dict"], prefix + "."
    return {name.removeprefix(start): value for name, value in weights.items() if name.startswith(start)}


def trained(make: Callable[[], Network], path: Path, part: str) -> Network:
    """A network with the weights of one part of a checkpoint's module, ready to be asked."""
    with seeded_initialisation(0):
        network = make()
    network.load_state_dict(load_weights(path, part))
    return network.eval()


def save_scene_model(path: Path, model: SceneModel) -> None:
    """Write the weights of a scene model with its sizes as one file."""
    sizes = {"grid": model.config.model_dump(), "hidden": model.hidden, "voxel_m": model.voxel_m}
    with replacing(path, "the scene model") as beside:
        weights = {name: one.detach().cpu().contiguous().clone() for name, one in model.state_dict().items()}
        save_file(weights, beside, {"sizes": json.dumps(sizes)})


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
