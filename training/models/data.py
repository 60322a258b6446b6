"""Batches: scenarios with their latents, configurations drawn from them, and pictures."""

from dataclasses import dataclass, fields
from typing import Self

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from cspace.world import World
from training.models.lookups import Scenes


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


@dataclass(frozen=True, slots=True)
class Cells:
    """Cells of the configuration space, with points spread evenly over each."""

    points: NDArray[np.float32]  # (k, p, d) float32 rad
    spacing_rad: NDArray[np.float32]  # (k,) float32, side of the cube that is one point's part of its cell
    labels: NDArray[np.int64]  # (M,) int64 cell of each configuration
    clusters: NDArray[np.int64]  # (k,) int64 cluster that each cell belongs to


@dataclass(frozen=True, slots=True)
class TrainingArrays:
    """What every trial on configurations reads."""

    configurations: NDArray[np.float32]  # (M, d) float32 rad
    ids: NDArray[np.int64]  # (M,) int64 scenario of each configuration
    labels: NDArray[np.int64]  # (M,) int64 cluster of each configuration
    mu: NDArray[np.float32]  # (S, L) float32 latent means
    sigma: NDArray[np.float32]  # (S, L) float32 latent standard deviations
    world: World
    images: NDArray[np.uint8] | None = None  # (S, P, P, 3) uint8; None without look-ups
    cells: Cells | None = None

    @property
    def scale(self) -> tuple[Tensor, Tensor]:
        """Mean and standard deviation of all configurations, each (d,) rad."""
        return torch.tensor(self.configurations.mean(axis=0)), torch.tensor(self.configurations.std(axis=0))

    def samples(self, cluster: int | None) -> ScenarioSamples:
        """The configurations of one cluster, or all of them; copied, for the shared ones are read-only."""
        rows = slice(None) if cluster is None else np.flatnonzero(self.labels == cluster)
        return ScenarioSamples(
            *(
                torch.tensor(array)
                for array in (self.configurations[rows], self.ids[rows], self.mu, self.sigma)
            )
        )

    def part(self, cluster: int | None) -> dict[str, float]:
        """Of a cluster or all data: its number, how many ``configurations``, and their ``share_of_data``."""
        count = len(self.labels) if cluster is None else int((self.labels == cluster).sum())
        number = {} if cluster is None else {"cluster": cluster}
        return number | {"configurations": count, "share_of_data": round(count / len(self.labels), 4)}

    def scenes(self) -> Scenes | None:
        """The pictures for look-ups, copied; None without."""
        return None if self.images is None else Scenes(self.world, torch.tensor(self.images))
