"""The arrays that every trial on configurations reads, shared through the object store."""

from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray

from cspace.world import World
from training.models.cells import Base, CellBase, CellPoints
from training.models.data import ScenarioSamples
from training.models.lookups.lookups import Scenes

# Keeps a row of probabilities from vanishing where the gate gives a scenario none of a cluster's cells.
_LEAST_PROBABILITY = 1e-8


@dataclass(frozen=True, slots=True)
class GatedCells:
    """The cells of the gate.

    Args:
        points: k cells with their points.
        labels: (M,) int64 cell of each configuration.
        clusters: (k,) int64 cluster that each cell belongs to.
        probabilities: (S, k) float32 by the trained gate; None before it is.
    """

    points: CellPoints
    labels: NDArray[np.int64]
    clusters: NDArray[np.int64]
    probabilities: NDArray[np.float32] | None = None


@dataclass(frozen=True, slots=True)
class TrainingArrays:
    """What every trial on configurations reads.

    Args:
        configurations: (M, d) float32 rad.
        ids: (M,) int64 scenario of each configuration.
        labels: (M,) int64 cluster of each configuration.
        mu: (S, L) float32 latent means.
        sigma: (S, L) float32 latent standard deviations.
        world: robot and sensor.
        images: (S, P, P, 3) uint8; None without look-ups.
        cells: of the gate; None without one.
    """

    configurations: NDArray[np.float32]
    ids: NDArray[np.int64]
    labels: NDArray[np.int64]
    mu: NDArray[np.float32]
    sigma: NDArray[np.float32]
    world: World
    images: NDArray[np.uint8] | None = None
    cells: GatedCells | None = None

    @property
    def scale(self) -> tuple[torch.Tensor, torch.Tensor]:
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
        """How much of the data a cluster has: ``configurations``, and their ``share_of_data``."""
        count = len(self.labels) if cluster is None else int((self.labels == cluster).sum())
        return {"configurations": count, "share_of_data": round(count / len(self.labels), 4)}

    def scenes(self) -> Scenes | None:
        """The pictures for look-ups, copied; None without."""
        return None if self.images is None else Scenes(self.world, torch.tensor(self.images))

    def base(self, cluster: int | None) -> Base | None:
        """What a generator starts from: the cells of one cluster, or of all; None for the whole space."""
        cells = self.cells
        if cells is None or cells.probabilities is None:
            return None
        inside = cells.clusters >= 0 if cluster is None else cells.clusters == cluster
        weights = (cells.probabilities + _LEAST_PROBABILITY) * inside
        return CellBase(cells.points, torch.tensor(weights.astype(np.float32)), self.world.space)

    def shares(self) -> torch.Tensor:
        """Share of every scenario's configurations in each cell, (S, k) float32.

        Raises:
            ValueError: there are no cells.
        """
        if self.cells is None:
            raise ValueError("shares need cells")
        counts = np.zeros((len(self.mu), len(self.cells.clusters)), dtype=np.float32)
        np.add.at(counts, (self.ids, self.cells.labels), 1.0)
        return torch.tensor(counts / np.maximum(counts.sum(axis=1, keepdims=True), 1.0))
