"""Where a torus generator starts: anywhere, or inside cells of the configuration space."""

from abc import ABC, abstractmethod
from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn

from cspace.space import JointSpace
from training.models.joints import Joints


@dataclass(frozen=True, slots=True)
class CellPoints:
    """Points spread evenly over each cell."""

    points: NDArray[np.float32]  # (k, p, d) float32 rad
    spacing_rad: NDArray[np.float32]  # (k,) float32, side of the cube that is one point's part of its cell


class Base(nn.Module, ABC):
    """What a torus generator starts from."""

    @abstractmethod
    def draw(self, ids: Tensor, rng: torch.Generator) -> Tensor:
        """(b, d) rad for scenarios (b,)."""


class UniformBase(Base):
    """The whole joint space, evenly."""

    def __init__(self, space: JointSpace) -> None:
        super().__init__()
        self.joints = Joints(space)

    def draw(self, ids: Tensor, rng: torch.Generator) -> Tensor:
        """See :class:`Base`; the scenarios do not matter."""
        shares = torch.rand(len(ids), self.joints.dim, generator=rng, device=ids.device)
        return self.joints.from_torus((2.0 * shares - 1.0) * torch.pi)


class CellBase(Base):
    """Evenly inside cells that are drawn by their probability under the scenario.

    ``probabilities`` (S, k) float32, not negative; a row need not sum to one.
    """

    points: Tensor
    spacing: Tensor
    probabilities: Tensor

    def __init__(self, cells: CellPoints, probabilities: Tensor, space: JointSpace) -> None:
        super().__init__()
        self.joints = Joints(space)
        self.register_buffer("points", torch.tensor(cells.points), persistent=False)
        self.register_buffer("spacing", torch.tensor(cells.spacing_rad), persistent=False)
        self.register_buffer("probabilities", probabilities, persistent=False)

    def draw(self, ids: Tensor, rng: torch.Generator) -> Tensor:
        """See :class:`Base`."""
        return self.draw_in_cells(ids, rng)[1]

    def draw_in_cells(self, ids: Tensor, rng: torch.Generator) -> tuple[Tensor, Tensor]:
        """The cells (b,) that were drawn for scenarios (b,), and a point in each, (b, d) rad."""
        count, device = len(ids), ids.device
        cell = torch.multinomial(self.probabilities[ids], 1, generator=rng).squeeze(1)
        place = torch.randint(self.points.shape[1], (count,), generator=rng, device=device)
        jitter = torch.rand(count, self.points.shape[2], generator=rng, device=device) - 0.5
        return cell, self.joints.fold(self.points[cell, place] + self.spacing[cell].unsqueeze(1) * jitter)
