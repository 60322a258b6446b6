"""Training and export of the validity head of a serial arm."""

from dataclasses import dataclass, replace
from typing import Self

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor
from torch.nn import functional

from cspace.world import GridArm, World
from training.config import GridConfig, ValidityConfig
from training.models.data import Held, rows_of
from training.models.export import Graph, exported
from training.models.grid_head import GridHead, HeadPrediction, counts_of
from training.models.modules import TrialModule

# Of what is 1 at most, so that its logarithm's complement is finite.
_MAX_LOG_FREE = -1e-6


@dataclass(frozen=True, slots=True)
class GridSamples(Held):
    """Pictures on disk, and labelled configurations in memory."""

    images: NDArray[np.uint8] | Tensor  # (S, X, Y, Z, 2) uint8, memory-mapped; a tensor in a GPU's memory
    configurations: Tensor  # (M, d) float32 rad, scenario after scenario
    free: Tensor  # (M,) bool
    hits: Tensor  # (M, G) bool, which groups of spheres touch an obstacle; (M, 0) where nobody knows
    offsets: Tensor  # (S + 1,) int64; scenario i owns rows offsets[i] to offsets[i + 1]

    def to(self, device: torch.device) -> Self:
        """The same with its tensors on another device; pictures stay where they are, unless that is a GPU."""
        names = ("configurations", "free", "hits", "offsets")
        moved = {name: getattr(self, name).to(device) for name in names}
        if device.type == "cuda":
            moved["images"] = torch.as_tensor(self.images).to(device)
        return replace(self, **moved)

    def draw(self, pictures: int, count: int, rng: torch.Generator) -> "GridBatch":
        """So many pictures with so many configurations each, with replacement."""
        device = self.offsets.device
        ids = torch.randint(len(self.images), (pictures,), generator=rng, device=device)
        rows = rows_of(self.offsets, ids, torch.rand(pictures, count, generator=rng, device=device))
        if isinstance(self.images, Tensor):
            shown = self.images[ids]
        else:
            shown = torch.from_numpy(np.stack([self.images[index] for index in ids.tolist()]))
        images = shown.movedim(-1, 1).contiguous().to(device)
        return GridBatch(images, self.configurations[rows], self.free[rows], self.hits[rows])


@dataclass(frozen=True, slots=True)
class GridBatch:
    """What one step learns from."""

    images: Tensor  # (p, 2, X, Y, Z) uint8
    configurations: Tensor  # (p, c, d) rad
    free: Tensor  # (p, c) bool
    hits: Tensor  # (p, c, G) bool, or (p, c, 0)

    def turned(self, quarters: int) -> "GridBatch":
        """The same scenes turned by quarters about the axis of the base and of the first joint."""
        images = torch.rot90(self.images, quarters, dims=(2, 3))
        first = self.configurations[..., :1] + quarters * np.pi / 2.0
        configurations = torch.cat([first, self.configurations[..., 1:]], dim=-1)
        return replace(self, images=images, configurations=configurations)


@dataclass(frozen=True, slots=True)
class ArmSamples(Held):
    """What is learned with several arms."""

    worlds: tuple[World, ...]
    samples: tuple[GridSamples, ...]

    def to(self, device: torch.device) -> Self:
        """The same with its tensors on another device."""
        return replace(self, samples=tuple(one.to(device) for one in self.samples))


class GridHeadModule(TrialModule):
    """Trains the head by cross entropy on free and colliding configurations, and on its groups' hazards.

    Configurations come as the data set has them, so that confidences are true to its mixture. Where the arm
    touches itself the head knows, and learns nothing of the scene unless the groups' truth is known.
    """

    samples: ArmSamples

    def __init__(self, config: ValidityConfig, samples: ArmSamples, seed: int) -> None:
        super().__init__(seed)
        self.config, self.samples = config, samples
        self.head = GridHead.of(config, samples.worlds[0])
        self.grid = config.grid or GridConfig()
        arms = [world.grid_arm(self.grid.groups) for world in samples.worlds]
        self.turns = [
            4 if _turns_upright(arm, counts_of(world)) else 1
            for arm, world in zip(arms, samples.worlds, strict=True)
        ]
        # Not registered, for they share all that is learned.
        self.heads = (
            self.head,
            *(
                GridHead(self.head.model, arm, counts_of(world))
                for arm, world in zip(arms[1:], samples.worlds[1:], strict=True)
            ),
        )
        self.shares = torch.tensor([float(len(one.images)) for one in samples.samples])
        self.one_cycle(self.parameters(), config.learning_rate, config.steps)

    def on_fit_start(self) -> None:
        """Keep data and arms where the model is."""
        super().on_fit_start()
        self.heads = tuple(head.to(self.device) for head in self.heads)

    def training_step(self, step: int, batch_index: int) -> None:
        """One step."""
        del step, batch_index
        config = self.config
        arm = int(torch.multinomial(self.shares.to(self.device), 1, generator=self.rng))
        held, head = self.samples.samples[arm], self.heads[arm]
        batch = held.draw(config.pictures_per_step, config.configurations_per_picture, self.rng)
        turns = torch.randint(self.turns[arm], (1,), generator=self.rng, device=self.device)
        batch = batch.turned(int(turns))
        pictures = batch.images.float() / 255.0
        prediction = head(pictures, head.encode(pictures), batch.configurations)
        losses = head_losses(prediction, batch)
        loss = losses["validity_loss"] + self.grid.hazard_weight * losses.get("hazard_loss", 0.0)
        self.descend(loss, self.grid.gradient_clip)
        right = ((prediction.free > 0.5) == batch.free).float().mean()
        self.latest = {name: value.detach() for name, value in losses.items()} | {"validity_accuracy": right}


def head_losses(prediction: HeadPrediction, batch: GridBatch) -> dict[str, Tensor]:
    """``validity_loss`` on whole configurations, and ``hazard_loss`` on groups where their truth is known."""
    known = prediction.itself > 0.5
    clear, losses = batch.free, dict[str, Tensor]()
    if batch.hits.shape[-1]:
        hits = batch.hits.float()
        losses["hazard_loss"] = functional.binary_cross_entropy_with_logits(prediction.hazards, hits)
        clear, known = ~batch.hits.any(dim=-1), torch.ones_like(known)
    log_free = prediction.clear.clamp(max=_MAX_LOG_FREE)
    each = -torch.where(clear, log_free, torch.log(-torch.expm1(log_free)))
    losses["validity_loss"] = (each * known).sum() / known.sum().clamp(min=1)
    return losses


def _turns_upright(arm: GridArm, counts: tuple[int, int, int]) -> bool:
    """Whether a quarter turn of the scene about the grid's middle is one of the first joint."""
    middle = arm.low_m + 0.5 * arm.voxel_m * np.asarray(counts)
    upright = np.allclose(arm.origins[0, :3, :3] @ arm.axes[0], (0.0, 0.0, 1.0))
    return bool(upright and np.allclose(middle[:2], arm.origins[0, :2, 3]) and counts[0] == counts[1])


def map_graph(head: GridHead) -> bytes:
    """ONNX bytes: ``image`` (1, 2, X, Y, Z) to ``map`` (X Y Z / 64, C), what the scene is taken to be."""
    return exported(Graph(head.encode, head), (torch.zeros(1, 2, *head.counts),), ["image"], ["map"], ({},))


def grid_validity_graph(head: GridHead, dim: int) -> bytes:
    """ONNX bytes: ``image``, ``map``, ``configurations`` (n, d) to ``confidence`` and ``unseen`` (n,)."""
    image = torch.zeros(1, 2, *head.counts)
    with torch.no_grad():
        seen = head.encode(image)
    rows = {0: torch.export.Dim("configurations", min=1)}
    inputs = (image, seen, torch.zeros(2, dim))
    names, outputs = ["image", "map", "configurations"], ["confidence", "unseen"]

    def confidence_and_unseen(image: Tensor, map_: Tensor, configurations: Tensor) -> tuple[Tensor, Tensor]:
        prediction = head(image, map_, configurations.unsqueeze(0))
        return prediction.free.squeeze(0), prediction.unseen.squeeze(0)

    return exported(Graph(confidence_and_unseen, head), inputs, names, outputs, ({}, {}, rows))
