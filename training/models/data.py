"""Batches: scenarios with their latents, configurations drawn from them, and pictures."""

from collections.abc import Iterator
from dataclasses import dataclass, fields
from typing import Self

import torch
from torch import Tensor
from torch.utils.data import IterableDataset


@dataclass(frozen=True, slots=True)
class Held:
    """Training data in memory: tensors that a model draws its batches from, on its own device."""

    def to(self, device: torch.device) -> Self:
        """The same on another device."""
        return type(self)(*(getattr(self, field.name).to(device) for field in fields(self)))


def rows_of(offsets: Tensor, ids: Tensor, shares: Tensor) -> Tensor:
    """Rows of scenarios (p,) at shares (p, c) in [0, 1) of each one's own, (p, c).

    Scenario i owns rows offsets[i] to offsets[i + 1].
    """
    first, size = offsets[ids], offsets[ids + 1] - offsets[ids]
    # float32 rounds shares just below 1 up; the row behind the last belongs to the next scenario.
    inside = torch.minimum((shares * size.unsqueeze(1)).long(), size.unsqueeze(1) - 1)
    return first.unsqueeze(1) + inside


@dataclass(frozen=True, slots=True)
class Batch:
    """Real configurations with the scenario that each belongs to."""

    configurations: Tensor  # (b, d) rad
    ids: Tensor  # (b,) scenario index
    mu: Tensor  # (b, L) mean of the scenario's latent
    sigma: Tensor  # (b, L) its standard deviation


@dataclass(frozen=True, slots=True)
class ScenarioSamples(Held):
    """Configurations of one cluster (or of all) with the latents of their scenarios."""

    configurations: Tensor  # (M, d) float32 rad
    ids: Tensor  # (M,) int64 scenario of each configuration
    mu: Tensor  # (S, L) float32
    sigma: Tensor  # (S, L) float32

    def draw(self, size: int, rng: torch.Generator) -> Batch:
        """A batch with replacement."""
        rows = torch.randint(len(self.ids), (size,), generator=rng, device=self.ids.device)
        ids = self.ids[rows]
        return Batch(self.configurations[rows], ids, self.mu[ids], self.sigma[ids])


class StepCounter(IterableDataset[int]):
    """Step numbers from ``first`` to ``last``: the modules draw their own batches on their own device."""

    def __init__(self, first: int, last: int) -> None:
        self.first, self.last = first, last

    def __iter__(self) -> Iterator[int]:
        return iter(range(self.first, self.last))

    def __len__(self) -> int:
        return self.last - self.first
