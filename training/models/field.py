"""The field of space: one arm-free network from the array of a view to log odds of occupancy, in one pass.

The loss is dense: it covers all voxels that no camera saw to be free, and the others as free checks.
"""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, cast

import lightning
import numpy as np
import torch
from lightning.pytorch.utilities.types import OptimizerLRSchedulerConfig
from numpy.typing import NDArray
from safetensors.torch import load_file
from torch import Tensor, nn
from torch.nn import functional

from cspace.world import World
from cspace.worlds.spatial.sensor import FREE, MOST_BEHIND, NO_READING
from training.config import GridConfig
from training.models.export import exported, pictures
from training.models.grid_head import CHANNELS, GridEncoder

# Of the scene model, whose encoder the field's begins as.
SIZES = GridConfig(finest=12, width=32, middle=64, deep=96)
FIELD_FILE = Path(__file__).parents[1] / "pretrained" / "field.safetensors"

# Log odds before anything is learned; weights of voxels that were seen free, and that no pixel is about.
_RARE, _SEEN_WEIGHT, _UNSURE_WEIGHT = -3.0, 0.1, 0.3
_HALF = 0.5 / 255.0
# Codes of voxels farther behind a surface than 5 cm.
_DEEP = 5


class FieldNet(nn.Module):
    """Arrays (p, 2, X, Y, Z) in [0, 1] to log odds of occupancy (p, X, Y, Z).

    A voxel is occupied where an obstacle is within half a voxel of its centre.

    Args:
        encoder: of a scene model, with features in cells of two voxels a side.
        width: channels of the decoder.
    """

    def __init__(self, encoder: GridEncoder, width: int = 32) -> None:
        super().__init__()
        self.encoder = encoder
        self.enter = nn.Conv3d(8 * CHANNELS + encoder.channels, width, 1)
        self.first, self.second = (nn.Conv3d(width, width, 3, padding=1) for _ in range(2))
        self.leave = nn.Conv3d(width, 8, 1)
        if self.leave.bias is not None:
            nn.init.constant_(self.leave.bias, _RARE)

    def forward(self, pictures: Tensor, low: Tensor) -> Tensor:
        """``low`` (3,) m is the grid's lowest corner in the base frame."""
        entered = self.enter(torch.cat([self.encoder(pictures, low), self._raw(pictures)], dim=1))
        inner = entered + self.second(functional.relu(self.first(functional.relu(entered))))
        return _unfolded(self.leave(functional.relu(inner)))

    def _raw(self, pictures: Tensor) -> Tensor:
        """What each voxel says, the eight of a cell as channels, (p, 8 C, X / 2, Y / 2, Z / 2)."""
        near, code = pictures[:, :1], pictures[:, 1:]
        free, out = (code < _HALF).float(), (code > 1.0 - _HALF).float()
        unread = ((code - self.encoder.no_reading).abs() < _HALF).float()
        hidden = 1.0 - free - out - unread
        states = torch.cat([near, free, unread, out, hidden, hidden * code], dim=1)
        p, c, x, y, z = states.shape
        cells = states.reshape(p, c, x // 2, 2, y // 2, 2, z // 2, 2).permute(0, 1, 3, 5, 7, 2, 4, 6)
        return cells.reshape(p, 8 * c, x // 2, y // 2, z // 2)


def _unfolded(cells: Tensor) -> Tensor:
    p, _, x, y, z = cells.shape
    parts = cells.reshape(p, 2, 2, 2, x, y, z).permute(0, 4, 1, 5, 2, 6, 3)
    return parts.reshape(p, 2 * x, 2 * y, 2 * z)


def new_field(world: World, weights: Mapping[str, Tensor]) -> FieldNet:
    """A field whose encoder begins as that of a scene model's weights."""
    encoder = GridEncoder(world.grid_arm(SIZES.groups), SIZES)
    own = {name: value for name, value in weights.items() if name.startswith("encoder.")}
    encoder.load_state_dict({name.removeprefix("encoder."): value for name, value in own.items()})
    return FieldNet(encoder)


def shipped_field(world: World) -> bytes:
    """ONNX bytes of the shipped field for the grid of a world's pictures, see :func:`field_graph`."""
    net = FieldNet(GridEncoder(world.grid_arm(SIZES.groups), SIZES))
    net.load_state_dict(load_file(FIELD_FILE))
    grid = cast("Any", world.sensor).grid
    return field_graph(net.eval(), grid.counts, grid.low_m)


class _FieldGraph(nn.Module):
    """One array of a grid to its voxels' probabilities."""

    low: Tensor

    def __init__(self, net: FieldNet, low_m: Sequence[float]) -> None:
        super().__init__()
        self.net = net
        self.register_buffer("low", torch.tensor(low_m))

    def forward(self, image: Tensor) -> Tensor:
        return torch.sigmoid(self.net(image, self.low))[0]


def field_graph(net: FieldNet, counts: Sequence[int], low_m: Sequence[float]) -> bytes:
    """ONNX bytes for one grid: ``image`` (1, 2, X, Y, Z) to the probabilities ``occupancy`` (X, Y, Z)."""
    return exported(_FieldGraph(net, low_m), (pictures(1, (2, *counts)),), ["image"], ["occupancy"], ({},))


class FieldModule(lightning.LightningModule):
    """Trains the field by cross entropy of single voxels."""

    def __init__(self, net: FieldNet, steps: int, learning_rate: float = 1e-3) -> None:
        super().__init__()
        self.net, self.steps, self.learning_rate = net, steps, learning_rate

    def training_step(self, batch: list[Tensor], index: int) -> Tensor:
        """The loss of some views of one grid."""
        del index
        arrays, occupied, low = batch
        logits = self.net(arrays.movedim(-1, 1).float() / 255.0, low[0])
        code = arrays[..., 1]
        # By what is known of a voxel, never by what is there, so that probabilities stay true.
        weight = torch.where(code == FREE, _SEEN_WEIGHT, torch.where(code >= NO_READING, _UNSURE_WEIGHT, 1.0))
        each = functional.binary_cross_entropy_with_logits(logits, occupied.float(), reduction="none")
        loss = (each * weight).sum() / weight.sum()
        self.log("field_loss", loss)
        return loss

    def configure_optimizers(self) -> OptimizerLRSchedulerConfig:
        """AdamW with a warm-up, and a linear way down over the last third."""
        optimizer = torch.optim.AdamW(self.parameters(), lr=self.learning_rate, weight_decay=1e-4)

        def scale(step: int) -> float:
            return max(0.02, min(1.0, (step + 1) / 200, 3.0 * (1.0 - step / self.steps)))

        schedule = torch.optim.lr_scheduler.LambdaLR(optimizer, scale)
        return {"optimizer": optimizer, "lr_scheduler": {"scheduler": schedule, "interval": "step"}}


@torch.no_grad()
def field_figures(
    net: FieldNet, low: Tensor, views: list[tuple[NDArray[np.uint8], NDArray[np.bool_]]]
) -> dict[str, float]:
    """Recall and precision at 0.5 over 5 cm behind seen surfaces, and log loss of all unseen voxels."""
    hits = hidden = predicted = 0
    losses = []
    for array, occupied in views:
        picture = torch.from_numpy(array).movedim(-1, 0)[None].float() / 255.0
        found = torch.sigmoid(net(picture, low))[0].numpy()
        code = array[..., 1]
        deep, unseen = (code > _DEEP) & (code <= MOST_BEHIND), code != FREE
        hits += int((found[deep & occupied] > 0.5).sum())
        hidden += int((deep & occupied).sum())
        predicted += int((found[deep] > 0.5).sum())
        sure = np.clip(np.where(occupied, found, 1.0 - found)[unseen], 1e-6, 1.0)
        losses.append(-np.log(sure).mean())
    return {
        "recall": hits / max(hidden, 1),
        "precision": hits / max(predicted, 1),
        "log_loss": float(np.mean(losses)),
    }
