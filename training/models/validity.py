"""The validity head: P(free | picture, configuration), looked up where the arm would be."""

from dataclasses import dataclass

import torch
from torch import Tensor, nn
from torch.nn import functional

from cspace.world import World
from cspace.worlds import simulator_of
from training.config import ValidityConfig
from training.models.data import Held, rows_of
from training.models.export import Graph, exported
from training.models.lookups import ArmLookups
from training.models.modules import TrialModule, mlp


class ValidityHead(nn.Module):
    """Pixel-aligned occupancy network: the picture at points of the arm, a perceptron, a logit.

    Shapes: pictures (p, 3, P, P) in [-1, 1] and configurations (p, c, d) rad to logits (p, c).
    """

    def __init__(self, lookups: ArmLookups, hidden: int, layers: int) -> None:
        super().__init__()
        self.lookups, self.net = lookups, mlp(lookups.values, hidden, layers, 1)

    def forward(self, pictures: Tensor, configurations: Tensor) -> Tensor:
        """The logit of being free.

        Each layer is one product of two matrices, which onnxruntime computes in one with its bias.
        """
        values = self.lookups(pictures, configurations)
        logits: Tensor = self.net(values.flatten(0, 1)).view(configurations.shape[:2])
        return logits


def make_head(config: ValidityConfig, world: World) -> ValidityHead:
    """The head that settings name."""
    return ValidityHead(
        ArmLookups(world, config.points_per_link, config.side_m), config.hidden, config.layers
    )


def validity_graph(head: ValidityHead, pixels: int, dim: int) -> bytes:
    """ONNX bytes: ``image`` (1, 3, P, P) and ``configurations`` (n, d) rad to ``confidence`` (n,)."""
    inputs = (torch.zeros(1, 3, pixels, pixels), torch.zeros(2, dim))
    rows = {0: torch.export.Dim("configurations", min=1)}
    graph = Graph(lambda image, rows: torch.sigmoid(head(image, rows.unsqueeze(0))).squeeze(0), head)
    return exported(graph, inputs, ["image", "configurations"], ["confidence"], ({}, rows))


@dataclass(frozen=True, slots=True)
class OccupancySamples(Held):
    """Pictures with their free and colliding configurations."""

    images: Tensor  # (S, 3, P, P) uint8
    free: Tensor  # (M, d) float32 rad, scenario after scenario
    free_offsets: Tensor  # (S + 1,) int64; scenario i owns rows offsets[i] to offsets[i + 1]
    collision: Tensor  # (N, d) float32 rad
    collision_offsets: Tensor  # (S + 1,) int64
    scenarios: Tensor  # (T,) int64, the scenarios that have configurations of both kinds

    def draw(
        self, pictures: int, free_count: int, collision_count: int, rng: torch.Generator
    ) -> tuple[Tensor, Tensor, Tensor]:
        """Pictures with so many free and so many colliding configurations each, drawn with replacement.

        Returns:
            Pictures (p, 3, P, P) in [-1, 1], configurations (p, c, d) rad, and labels (p, c), 1 for free.
        """
        device = self.images.device
        ids = self.scenarios[torch.randint(len(self.scenarios), (pictures,), generator=rng, device=device)]
        shares = torch.rand(pictures, free_count + collision_count, generator=rng, device=device)
        free = self.free[rows_of(self.free_offsets, ids, shares[:, :free_count])]
        collision = self.collision[rows_of(self.collision_offsets, ids, shares[:, free_count:])]
        labels = torch.cat([torch.ones_like(free[..., 0]), torch.zeros_like(collision[..., 0])], dim=1)
        return self.images[ids].float() / 127.5 - 1.0, torch.cat([free, collision], dim=1), labels


class ValidityModule(TrialModule):
    """Trains the head by cross entropy on free and colliding configurations.

    Their numbers are in proportion to the free share of the joint space, for else the confidences would be
    true to another world: drawn in equal numbers, a 0.5 would mean that share.
    """

    samples: OccupancySamples

    def __init__(self, config: ValidityConfig, samples: OccupancySamples, world: World, seed: int) -> None:
        super().__init__(seed)
        self.config, self.samples = config, samples
        self.head = make_head(config, world)
        every = config.configurations_per_picture
        self.free = min(every - 1, max(1, round(simulator_of(world).measures.free_share * every)))
        self.one_cycle(self.parameters(), config.learning_rate, config.steps)

    def training_step(self, step: int, batch_index: int) -> None:
        """One step of the cross entropy."""
        del step, batch_index
        colliding = self.config.configurations_per_picture - self.free
        pictures, configurations, labels = self.samples.draw(
            self.config.pictures_per_step, self.free, colliding, self.rng
        )
        logits = self.head(pictures, configurations)
        loss = functional.binary_cross_entropy_with_logits(logits, labels)
        self.descend(loss)
        right = ((logits.detach() > 0.0) == (labels > 0.5)).float().mean()
        self.latest = {"validity_loss": loss.detach(), "validity_accuracy": right}
