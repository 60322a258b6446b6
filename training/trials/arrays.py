"""The arrays that trials read, shared through the object store."""

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray
from torch import nn

from cspace.dataset import Dataset, open_dataset
from cspace.world import Sensor, World
from cspace.worlds import simulator_of
from training.config import HeadConfig
from training.models.autoencoders import (
    GridNovelty,
    GridVaeDecoder,
    GridVaeEncoder,
    NoveltyScores,
    blocks,
    make_decoder,
    make_encoder,
    shown_size,
)
from training.models.cells import Base, CellBase, CellPoints
from training.models.checkpoint import load_scene_model, trained
from training.models.data import ScenarioSamples
from training.models.grid_training import ArmSamples, GridHeadModule, GridSamples
from training.models.lookups import Scenes
from training.models.modules import TrialModule
from training.models.networks import Encoder
from training.models.settings import GridConfig, VaeConfig, ValidityConfig
from training.models.validity import OccupancySamples, ValidityModule


def load_encoder(config: VaeConfig, sensor: Sensor, checkpoint: Path) -> Encoder | GridVaeEncoder:
    """The encoder of a VAE trial's checkpoint, ready to be asked."""
    return trained(lambda: make_encoder(config, shown_size(sensor)), checkpoint, "encoder")


def load_scores(config: VaeConfig, sensor: Sensor, checkpoint: Path) -> nn.Module:
    """The novelty scores by the decoder of a VAE trial's checkpoint."""
    decoder = trained(lambda: make_decoder(config, shown_size(sensor)), checkpoint, "decoder")
    if isinstance(decoder, GridVaeDecoder):
        return GridNovelty(decoder).eval()
    return NoveltyScores(decoder, sensor.pixels).eval()


# Keeps a row of probabilities from vanishing where the gate gives a scenario none of a cluster's cells.
_LEAST_PROBABILITY = 1e-8


@dataclass(frozen=True, slots=True)
class GatedCells:
    """The cells of the gate."""

    points: CellPoints
    labels: NDArray[np.int64]  # (M,) int64 cell of each configuration
    clusters: NDArray[np.int64]  # (k,) int64 cluster that each cell belongs to
    probabilities: NDArray[np.float32] | None = None  # (S, k) float32 by the trained gate; None before it is


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
    cells: GatedCells | None = None

    @classmethod
    def unencoded(
        cls,
        dataset: Dataset,
        configurations: NDArray[np.float32],
        ids: NDArray[np.int64],
        labels: NDArray[np.int64],
        latent_dim: int,
        cells: GatedCells | None = None,
    ) -> "TrainingArrays":
        """With latents of zeros, for pictures whose encoder does not exist yet."""
        nothing = np.zeros((dataset.scenario_count, latent_dim), dtype=np.float32)
        return cls(configurations, ids, labels, nothing, nothing, dataset.world, cells=cells)

    def encoded(self, encoder: nn.Module, images: NDArray[np.uint8]) -> "TrainingArrays":
        """With the latents of the scenarios' pictures, (S, ...)."""
        means, deviations, sensor = [], [], self.world.sensor
        with torch.inference_mode():
            for rows in blocks(sensor, len(images)):
                mu, log_variance = encoder(torch.from_numpy(sensor.to_network(np.asarray(images[rows]))))
                means.append(mu.numpy())
                deviations.append((log_variance / 2.0).exp().numpy())
        return replace(self, mu=np.concatenate(means), sigma=np.concatenate(deviations))

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
        """Share of every scenario's configurations in each cell, (S, k) float32."""
        if self.cells is None:
            raise ValueError("shares need cells")
        counts = np.zeros((len(self.mu), len(self.cells.clusters)), dtype=np.float32)
        np.add.at(counts, (self.ids, self.cells.labels), 1.0)
        return torch.tensor(counts / np.maximum(counts.sum(axis=1, keepdims=True), 1.0))


def has_occupancy(dataset: Dataset, config: ValidityConfig) -> bool:
    """Whether a head can learn from a data set: along links it needs scenarios with both kinds."""
    if dataset.collision is None:
        return False
    return config.grid is not None or len(_with_both_kinds(dataset)) > 0


def head_module(
    folder: Path, config: HeadConfig, images: torch.Tensor, seed: int, outcomes: Path | None = None
) -> TrialModule:
    """The training of a validity head."""
    dataset = open_dataset(folder, verify=False)
    if config.grid is None:
        return ValidityModule(config, occupancy_samples(dataset, images), dataset.world, seed)
    file, grid = config.scene_model_file, config.grid
    start = None if file is None else load_scene_model(file, dataset.world)
    if start is not None:
        grid = start.config
        config = config.model_copy(update={"grid": grid, "hidden": start.hidden})
    sets = [dataset, *([] if outcomes is None else [open_dataset(outcomes, verify=False)])]
    held = ArmSamples(tuple(one.world for one in sets), tuple(grid_samples(one, grid) for one in sets))
    module = GridHeadModule(config, held, seed)
    if start is not None:
        module.head.model.load_state_dict(start.state_dict())
    return module


def occupancy_samples(dataset: Dataset, images: torch.Tensor) -> OccupancySamples:
    """Free and colliding configurations by scenario; copied, for those of the data set are read-only.

    ``images`` (S, 3, P, P) uint8, and further ones behind them that have no configurations.
    """
    names = ("free", "free_offsets", "collision", "collision_offsets")
    arrays = [*(dataset.arrays[name] for name in names), _with_both_kinds(dataset)]
    tensors = (torch.tensor(np.asarray(array)) for array in arrays)
    return OccupancySamples(images[: dataset.scenario_count], *tensors)


def _with_both_kinds(dataset: Dataset) -> NDArray[np.int64]:
    """Scenarios with free configurations and with some in collision."""
    counts = [np.diff(dataset.arrays[f"{kind}_offsets"]) for kind in ("free", "collision")]
    return np.flatnonzero((counts[0] > 0) & (counts[1] > 0))


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
    return simulator_of(dataset.world).group_hits(scene, rows, groups)
