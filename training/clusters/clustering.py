"""k-means over the configuration space, on its embedding so that clusters respect circles and limits."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from sklearn.cluster import KMeans
from sklearn.metrics import pairwise_distances_argmin

from cspace.errors import ConfigError
from cspace.files import replacing
from cspace.simulator import derived_seed
from cspace.space import JointSpace
from training.models.data import Cells

_FIT_SAMPLES = 50_000
# Cells differ in size; one that is too small for this many draws repeats the points that it has.
_DRAWS_PER_POINT = 5


@dataclass(frozen=True, slots=True)
class Clustering:
    """A partition of the configuration space."""

    centres: NDArray[np.float64]  # (k, e) in the embedding
    labels: NDArray[np.int64]  # (M,) cluster of each configuration
    space: JointSpace

    def label(self, configurations: NDArray[np.floating[Any]]) -> NDArray[np.int64]:
        """The cluster of each of (n, d) configurations: the one with the nearest centre."""
        nearest = pairwise_distances_argmin(self.space.embed(configurations), self.centres)
        return np.asarray(nearest, dtype=np.int64)

    @property
    def sizes(self) -> tuple[int, ...]:
        """Configurations in each cluster."""
        return tuple(int(n) for n in np.bincount(self.labels, minlength=len(self.centres)))


@dataclass(frozen=True, slots=True)
class Partition:
    """Cells of the configuration space and what they are grouped into, one cluster a local trial."""

    cells: Clustering
    clusters: NDArray[np.int64]  # (k,) cluster of each cell

    @property
    def labels(self) -> NDArray[np.int64]:
        """(M,) cluster of each configuration."""
        return self.clusters[self.cells.labels]

    def with_points(self, points: int, seed: int) -> Cells | None:
        """The cells with so many points in each; None for none."""
        if points == 0:
            return None
        spread, spacing_rad = points_in_cells(self.cells, points, seed)
        return Cells(spread, spacing_rad, self.cells.labels, self.clusters)

    def save(self, path: Path) -> None:
        """Keep it for a job that goes on."""
        with replacing(path, str(path)) as beside, beside.open("wb") as handle:
            np.savez(handle, centres=self.cells.centres, clusters=self.clusters, cells=self.cells.labels)

    @classmethod
    def read(cls, path: Path, configurations: NDArray[np.float32], space: JointSpace) -> "Partition | None":
        """The partition of the same (M, d) configurations that an earlier attempt saved; None without one."""
        try:
            with np.load(path, allow_pickle=False) as kept:
                found = cls(Clustering(kept["centres"], kept["cells"], space), kept["clusters"])
        except (FileNotFoundError, KeyError):
            return None
        if len(found.labels) != len(configurations):
            raise ConfigError(
                "the data are not those that the job began with",
                expected=f"{len(found.labels)} configurations",
                got=str(len(configurations)),
                remedy="submit the job under another name",
            )
        return found


def cluster(
    configurations: NDArray[np.float32],
    count: int,
    seed: int,
    space: JointSpace,
) -> Clustering:
    """Partition (M, d) configurations into ``count`` clusters."""
    total = len(configurations)
    if total < count:
        raise ConfigError(
            "there are too few configurations to cluster",
            expected=f"at least {count}",
            got=str(total),
            remedy="lower clusters.count or raise data.free_per_scenario",
        )
    rng = np.random.default_rng(derived_seed(seed, "rows of k-means"))
    rows = rng.choice(total, size=min(total, _FIT_SAMPLES), replace=False)
    model = KMeans(count, n_init=4, random_state=_state(seed, "cells")).fit(space.embed(configurations[rows]))
    labels = model.predict(space.embed(configurations)).astype(np.int64)
    return Clustering(np.asarray(model.cluster_centers_, dtype=np.float64), labels, space)


def _state(seed: int, use: str) -> int:
    """A seed that scikit-learn takes."""
    return derived_seed(seed, use) % 2**32


def group(cells: Clustering, count: int, seed: int) -> NDArray[np.int64]:
    """The cluster of each of k cells, (k,), by k-means over their centres."""
    if count == len(cells.centres):
        return np.arange(count)
    model = KMeans(count, n_init=4, random_state=_state(seed, "clusters of cells"))
    return np.asarray(model.fit(cells.centres, sample_weight=cells.sizes).labels_, dtype=np.int64)


def points_in_cells(
    cells: Clustering, points: int, seed: int
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Configurations spread evenly, (k, points, d) rad, and the side of a point's cube in each cell, (k,)."""
    rng = np.random.default_rng(derived_seed(seed, "points in cells"))
    count, space = len(cells.centres), cells.space
    draws = space.sample_uniform(rng, _DRAWS_PER_POINT * points * count)
    labels = cells.label(draws)
    found = [draws[labels == cell] for cell in range(count)]
    if min(map(len, found)) == 0:
        raise ConfigError(
            "a cell of the gate is next to empty",
            expected=f"{count} cells of comparable size",
            got=f"one without any of {len(draws)} draws",
            remedy="lower gate.cells",
        )
    volumes = np.array([len(cell) for cell in found]) / len(draws) * space.volume
    kept = [cell[np.arange(points) % len(cell)] for cell in found]
    spacing = (volumes / points) ** (1.0 / space.dim)
    return np.stack(kept).astype(np.float32), spacing.astype(np.float32)
