"""Paths as training data: points of a path with its ends, the place along it, and what the picture shows."""

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from cspace.dataset import Dataset
from cspace.errors import DatasetError
from cspace.path_points import spread_points
from training.models.data import Held

MIN_POINTS = 2


@dataclass(frozen=True, slots=True)
class PathBatch:
    """Points of paths.

    Args:
        points: (b, d) rad, one of each path.
        place: (b, 1) share of the path's length from its start to the point, 0 to 1.
        start: (b, d) rad.
        goal: (b, d) rad.
        ids: (b,) scenario.
        mu: (b, L) mean of the scenario's latent.
        sigma: (b, L) its standard deviation.
    """

    points: Tensor
    place: Tensor
    start: Tensor
    goal: Tensor
    ids: Tensor
    mu: Tensor
    sigma: Tensor


@dataclass(frozen=True, slots=True)
class PathSamples(Held):
    """Paths of equally many points with the latents of their scenarios.

    Args:
        paths: (T, P, d) float32 rad, points at equal distances.
        ids: (T,) int64 scenario of each path.
        mu: (S, L) float32.
        sigma: (S, L) float32.
    """

    paths: Tensor
    ids: Tensor
    mu: Tensor
    sigma: Tensor

    def draw_rows(self, size: int, rng: torch.Generator) -> tuple[Tensor, Tensor]:
        """Numbers of paths (b,), and which of them are walked from goal to start (b,): every other one."""
        rows = torch.randint(len(self.ids), (size,), generator=rng, device=self.ids.device)
        # What is a near-optimal path one way is one the other way.
        return rows, torch.rand(size, generator=rng, device=self.ids.device) < 0.5

    def walked(self, rows: Tensor, back: Tensor) -> Tensor:
        """Those paths, (b, P, d) rad."""
        paths = self.paths[rows]
        return torch.where(back.view(-1, 1, 1), paths.flip(1), paths)

    def draw(self, size: int, rng: torch.Generator) -> PathBatch:
        """One point of each of so many paths, both with replacement."""
        rows, back = self.draw_rows(size, rng)
        paths, ids = self.walked(rows, back), self.ids[rows]
        count = paths.shape[1]
        at = torch.randint(count, (size,), generator=rng, device=ids.device)
        points = paths[torch.arange(size, device=ids.device), at]
        place = (at / (count - 1)).unsqueeze(1)
        return PathBatch(points, place, paths[:, 0], paths[:, -1], ids, self.mu[ids], self.sigma[ids])


def equal_paths(dataset: Dataset, points: int) -> tuple[NDArray[np.float32], NDArray[np.int64]]:
    """All paths of a data set with ``points`` points at equal distances, (T, points, d), and their scenarios.

    Raises:
        DatasetError: the data set holds no paths, or one of a single point.
    """
    if not {"paths", "path_offsets", "path_scenario"} <= set(dataset.arrays):
        raise DatasetError("the data set holds no paths", expected="paths.npy", got=str(dataset.folder))
    rows, offsets = dataset.arrays["paths"], dataset.arrays["path_offsets"]
    sizes = np.diff(offsets)
    if len(sizes) == 0 or sizes.min() < MIN_POINTS:
        raise DatasetError(
            "the data set's paths do not fit",
            expected="paths of two points or more",
            got=str(sizes.min(initial=0)),
        )
    owner = np.asarray(dataset.arrays["path_scenario"])
    if (sizes == points).all():
        return np.asarray(rows).reshape(-1, points, dataset.dim), owner
    space = dataset.world.space
    parts = [spread_points(np.asarray(rows[a:b], np.float64), points, space) for a, b in pairwise(offsets)]
    return np.stack(parts).astype(np.float32), owner
