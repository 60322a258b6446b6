"""The graphs of a head that reads arrays of space."""

import torch
from torch import Tensor, nn

from training.models.export import exported
from training.models.grids.head import GridHead


class _MapGraph(nn.Module):
    def __init__(self, head: GridHead) -> None:
        super().__init__()
        self.head = head

    def forward(self, image: Tensor) -> Tensor:
        return self.head.encode(image)


class _ValidityGraph(nn.Module):
    def __init__(self, head: GridHead) -> None:
        super().__init__()
        self.head = head

    def forward(self, image: Tensor, map_: Tensor, configurations: Tensor) -> tuple[Tensor, Tensor]:
        belief = self.head(image, map_, configurations.unsqueeze(0))
        return belief.free.squeeze(0), belief.unseen.squeeze(0)


def map_graph(head: GridHead) -> bytes:
    """ONNX bytes: ``image`` (1, 2, X, Y, Z) to ``map`` (X Y Z / 64, C), what the scene is taken to be."""
    return exported(_MapGraph(head), (torch.zeros(1, 2, *head.counts),), ["image"], ["map"], ({},))


def grid_validity_graph(head: GridHead, dim: int) -> bytes:
    """ONNX bytes: ``image``, ``map``, ``configurations`` (n, d) to ``confidence`` and ``unseen`` (n,)."""
    image = torch.zeros(1, 2, *head.counts)
    with torch.no_grad():
        seen = head.encode(image)
    rows = {0: torch.export.Dim("configurations", min=1)}
    inputs = (image, seen, torch.zeros(2, dim))
    names, outputs = ["image", "map", "configurations"], ["confidence", "unseen"]
    return exported(_ValidityGraph(head), inputs, names, outputs, ({}, {}, rows))
