"""A density of paths on a grid of the joint space: a U-Net over the validity head's map with start and goal.

For every cell it tells how much of the path runs there, how far along the path that is, and where in it.
Samples are drawn from the cells in the order of the path, so that one uniform number is a place along it.
"""

from dataclasses import dataclass

import torch
from torch import Tensor, nn
from torch.nn import functional

from cspace.space import JointSpace
from training.models.modules import TrialModule
from training.models.paths.condition import swept
from training.models.paths.samples import PathSamples
from training.models.paths.settings import DensityConfig
from training.models.paths.unet import CellGrid, PathUNet
from training.models.ways.fields import backwards, stored_fields


@dataclass(frozen=True, slots=True)
class Targets:
    """What the U-Net learns of a batch: shares (b, n), places (b, n) and offsets (b, n, 2) of the path."""

    shares: Tensor
    places: Tensor
    offsets: Tensor


def path_targets(paths: Tensor, grid: CellGrid) -> Targets:
    """Of paths (b, P, 2): which share of the points lies in each cell, and their mean place and offset."""
    size, count, dim = paths.shape
    cell = grid.cell(paths)
    cells = grid.cells**2
    place = torch.linspace(0.0, 1.0, count, device=paths.device).expand(size, count)
    offset = grid.difference(grid.centres[cell], paths) / grid.size
    blank = torch.zeros(size, cells, device=paths.device)
    number = blank.scatter_add(1, cell, torch.ones_like(place))
    least = number.clamp(min=1.0)
    places = blank.scatter_add(1, cell, place) / least
    offsets = [blank.scatter_add(1, cell, offset[..., axis]) / least for axis in range(dim)]
    return Targets(number / count, places, torch.stack(offsets, dim=-1))


class DensityModule(TrialModule):
    """Trains the U-Net on maps of the validity head and near-optimal paths.

    Args:
        config: sizes and budget.
        samples: the paths.
        maps: (S, c, c) uint8, the head's confidence at the cells' centres in 255 steps.
        fields: (T, 2, c, c) uint8, detour and progress of every path as :mod:`training.models.ways.fields`
            stores them; None where the U-Net does not see them.
        space: the joint space.
        seed: of initialisation and of every draw.
    """

    maps: Tensor
    samples: PathSamples

    def __init__(
        self,
        config: DensityConfig,
        samples: PathSamples,
        maps: Tensor,
        fields: Tensor | None,
        space: JointSpace,
        seed: int,
    ) -> None:
        super().__init__(seed)
        self.config, self.samples = config, samples
        self.register_buffer("maps", maps, persistent=False)
        self.fields = fields
        self.net = PathUNet(CellGrid(space, config.cells), config.width, ways=config.ways)
        self.one_cycle(self.parameters(), config.learning_rate, config.steps)

    def on_fit_start(self) -> None:
        """Keep the data where the model is."""
        super().on_fit_start()
        self.fields = None if self.fields is None else self.fields.to(self.device)

    def training_step(self, step: int, batch_index: int) -> None:
        """Cross entropy of the density; place and offset where the path runs."""
        del step, batch_index
        rows, back = self.samples.draw_rows(self.config.batch_size, self.rng)
        maps, paths = self._maps(rows, back), self.samples.walked(rows, back)
        if all(self.net.grid.periodic):
            maps, paths = self._turned(maps, paths)
        targets = path_targets(paths, self.net.grid)
        found = self.net(maps, paths[:, 0], paths[:, -1])
        density = -(targets.shares * functional.log_softmax(found.density, dim=1)).sum(dim=1).mean()
        wrong = functional.binary_cross_entropy_with_logits(found.progress, targets.places, reduction="none")
        progress = (targets.shares * wrong).sum(dim=1).mean()
        offset = (
            (targets.shares.unsqueeze(2) * (found.offset - targets.offsets).square()).sum(dim=(1, 2)).mean()
        )
        self.descend(density + progress + offset, clip=5.0)
        self.latest = {
            "density_loss": density.detach(),
            "progress_loss": progress.detach(),
            "offset_loss": offset.detach(),
        }

    def _maps(self, rows: Tensor, back: Tensor) -> Tensor:
        confidence = self.maps[self.samples.ids[rows]].unsqueeze(1).float() / 255.0
        if self.fields is None:
            return confidence
        detour, progress = stored_fields(self.fields[rows])
        progress = torch.where(back.view(-1, 1, 1, 1), backwards(detour, progress), progress)
        return torch.cat([confidence, detour, progress], dim=1)

    def _turned(self, maps: Tensor, paths: Tensor) -> tuple[Tensor, Tensor]:
        """Both joints mirrored, swapped and turned at random: the net sees the map alone, not the arm."""
        mirrored = self.uniform(2) < 0.5
        for axis in range(2):
            if mirrored[axis]:
                maps = maps.flip(2 + axis)
                paths = torch.cat(
                    [-paths[..., :1], paths[..., 1:]] if axis == 0 else [paths[..., :1], -paths[..., 1:]],
                    dim=-1,
                )
        if self.uniform(1) < 0.5:
            maps, paths = maps.transpose(2, 3), paths.flip(-1)
        cells = self.net.grid.cells
        turns = torch.randint(cells, (2,), generator=self.rng, device=self.device)
        maps = maps.roll((int(turns[0]), int(turns[1])), (2, 3))
        moved = paths + turns * (2.0 * torch.pi / cells)
        return maps, torch.remainder(moved + torch.pi, 2.0 * torch.pi) - torch.pi


class DensitySampler(nn.Module):
    """Samples along the path by the maps, as one graph after the validity head's.

    Shapes: maps (k n,), place (m, 1) in [0, 1), jitter (m, 2), start and goal (m, 2) rad, all rows alike, to
    (m, 1, 2) rad.
    """

    def __init__(self, net: PathUNet, config: DensityConfig, sweep: int) -> None:
        super().__init__()
        self.net, self.sweep = net, sweep
        self.jitter_rad, self.sharpness, self.penalty = config.jitter_rad, config.sharpness, config.penalty

    def forward(self, maps: Tensor, place: Tensor, jitter: Tensor, start: Tensor, goal: Tensor) -> Tensor:
        """Each row at its own share of the density, cells taken in the order of the path."""
        grid = self.net.grid
        found = self.net(maps.view(1, -1, grid.cells, grid.cells), start[:1], goal[:1])
        order = torch.argsort(found.progress[0])
        density = functional.softmax(self.sharpness * found.density[0][order], dim=0)
        reached = torch.cumsum(density, dim=0)
        wanted = swept(place, self.sweep) * reached[-1]
        chosen = order[(reached <= wanted).sum(dim=1).clamp(max=len(order) - 1)]
        # No farther than the cell's own border: an offset is told from inside.
        offset = found.offset[0][chosen].clamp(-0.5, 0.5)
        samples: Tensor = grid.centres[chosen] + offset * grid.size + self.jitter_rad * jitter
        return grid.joints.fold(samples).unsqueeze(1)
