"""What the trial of a head that reads arrays of space learns from: the data set itself, for it is large."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray

from cspace.dataset import Dataset, open_dataset
from cspace.errors import JobError
from cspace.worlds import workshop_of
from training.models.grids.training import GridHeadModule, GridSamples
from training.models.modules import TrialModule
from training.models.settings import GridConfig, ValidityConfig


@dataclass(frozen=True, slots=True)
class GridOccupancy:
    """A data set's folder, which every node can read."""

    folder: Path

    @classmethod
    def of(cls, dataset: Dataset) -> "GridOccupancy | None":
        """The data set's; None without configurations in collision."""
        return None if dataset.collision is None else cls(dataset.folder.absolute())

    def module(self, config: ValidityConfig, images: torch.Tensor, seed: int) -> TrialModule:
        """The head's training; pictures are read where they lie.

        Raises:
            JobError: the settings are of another head.
        """
        del images
        if config.grid is None:
            raise JobError("a head of arrays of space needs its sizes", expected="validity.grid", got="none")
        dataset = open_dataset(self.folder, verify=False)
        return GridHeadModule(config, grid_samples(dataset, config.grid), dataset.world, seed)


def grid_samples(dataset: Dataset, config: GridConfig) -> GridSamples:
    """Pictures as they lie on disk; labelled configurations, and what they hit where obstacles are known."""
    rows, free, hits = [], [], []
    for scenario in range(dataset.scenario_count):
        sides = (np.asarray(dataset.free_of(scenario)), np.asarray(dataset.collision_of(scenario)))
        rows.append(np.concatenate(sides))
        free.append(np.repeat([True, False], [len(side) for side in sides]))
        hits.append(_hits(dataset, scenario, rows[-1], config.groups))
    offsets = np.cumsum([0, *(len(one) for one in rows)], dtype=np.int64)
    return GridSamples(
        dataset.images,
        torch.from_numpy(np.concatenate(rows)),
        torch.from_numpy(np.concatenate(free)),
        torch.from_numpy(np.concatenate(hits)),
        torch.from_numpy(offsets),
    )


def _hits(dataset: Dataset, scenario: int, rows: NDArray[np.float32], groups: int) -> NDArray[np.bool_]:
    names = dataset.world.scene_files
    if not set(names) <= set(dataset.arrays):
        return np.zeros((len(rows), 0), dtype=np.bool_)
    scene = {name: np.asarray(dataset.arrays[name][scenario]) for name in names}
    return workshop_of(dataset.world).group_hits(scene, rows, groups)
