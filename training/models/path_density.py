"""A density of paths on a grid of the joint space: a U-Net over the validity head's map with start and goal.

For every cell it tells how much of the path runs there, how far along the path that is, and where in it.
Samples are drawn from the cells in the order of the path, so that one uniform number is a place along it.
"""

from dataclasses import dataclass
from typing import NamedTuple

import torch
from torch import Tensor, nn
from torch.nn import functional

from cspace.space import JointSpace
from training.models.modules import TrialModule
from training.models.path_condition import swept
from training.models.path_samples import PathSamples
from training.models.way_fields import backwards, stored_fields
from training.path_config import DensityConfig

# One cell wide, so that start and goal are seen wherever in their cells they lie.
MARK_CELLS = 1.0
OUTPUTS = 4
# Detours far below the first are as good as none, far beyond the second as good as no way.
DETOUR_RAD = (0.3, 1.5)


class CellGrid(nn.Module):
    """The cells of the torus.

    Args:
        space: of two joints, both circles or with limits.
        cells: along each joint.
    """

    centres: Tensor
    low: Tensor
    size: Tensor
    wraps: Tensor

    def __init__(self, space: JointSpace, cells: int) -> None:
        super().__init__()
        self.cells, self.periodic = cells, tuple(space.periodic)
        low, high = torch.tensor(space.lower), torch.tensor(space.upper)
        size = (high - low) / cells
        axes = [low[joint] + (torch.arange(cells) + 0.5) * size[joint] for joint in range(space.dim)]
        grid = torch.stack(torch.meshgrid(*axes, indexing="ij"), dim=-1)
        self.register_buffer("centres", grid.reshape(-1, space.dim).float(), persistent=False)
        self.register_buffer("low", low.float(), persistent=False)
        self.register_buffer("size", size.float(), persistent=False)
        self.register_buffer("wraps", torch.tensor(space.periodic).float(), persistent=False)

    def difference(self, start: Tensor, end: Tensor) -> Tensor:
        """The way from one to the other, the shorter one on circles."""
        plain = end - start
        return plain - self.wraps * (2.0 * torch.pi) * torch.round(plain / (2.0 * torch.pi))

    def cell(self, points: Tensor) -> Tensor:
        """Number of the cell of each point, (..., d) rad to (...)."""
        place = ((points - self.low) / self.size).floor().long().clamp(0, self.cells - 1)
        return place[..., 0] * self.cells + place[..., 1]

    def marks(self, points: Tensor) -> Tensor:
        """(b, d) rad to (b, c, c): 1 at the point, falling off as a bell."""
        away = self.difference(points.unsqueeze(1), self.centres) / self.size
        bell = torch.exp(-away.square().sum(dim=-1) / (2.0 * MARK_CELLS**2))
        return bell.view(-1, self.cells, self.cells)


class WrappedConv(nn.Module):
    """A 3 x 3 convolution on a grid whose axes may wrap: (b, i, h, w) to (b, o, h, w)."""

    def __init__(self, inputs: int, outputs: int, periodic: tuple[bool, ...]) -> None:
        super().__init__()
        self.periodic = periodic
        self.conv = nn.Conv2d(inputs, outputs, 3)

    def forward(self, values: Tensor) -> Tensor:
        """Joined at the ends, or zero beyond limits."""
        for axis, wraps in zip((2, 3), self.periodic, strict=True):
            first, last = values.narrow(axis, 0, 1), values.narrow(axis, values.shape[axis] - 1, 1)
            parts = [last, values, first] if wraps else [0.0 * first, values, 0.0 * last]
            values = torch.cat(parts, dim=axis)
        convolved: Tensor = self.conv(values)
        return convolved


class Block(nn.Module):
    """Two convolutions, with what came in added to what goes out."""

    def __init__(self, inputs: int, outputs: int, periodic: tuple[bool, ...]) -> None:
        super().__init__()
        self.first = WrappedConv(inputs, outputs, periodic)
        self.second = WrappedConv(outputs, outputs, periodic)

    def forward(self, values: Tensor) -> Tensor:
        """(b, inputs, h, w) to (b, outputs, h, w)."""
        before = functional.leaky_relu(self.first(values), 0.1)
        return functional.leaky_relu(self.second(before), 0.1) + before


class CellMaps(NamedTuple):
    """What the U-Net tells of each cell.

    Args:
        density: (b, n) logits of the path's share in it.
        progress: (b, n) logits of the place along the path.
        offset: (b, n, 2) from the cell's centre, in cells.
    """

    density: Tensor
    progress: Tensor
    offset: Tensor


class PathUNet(nn.Module):
    """The U-Net: maps (b, k, c, c), start and goal (b, d) rad to :class:`CellMaps`.

    The maps are the head's confidence and, for ``ways``, the detour and the progress of
    :mod:`training.models.way_fields`. It works at half their resolution and below, where convolutions cost a
    quarter; the last one sees them again as they are.
    """

    def __init__(self, grid: CellGrid, width: int, *, ways: bool) -> None:
        super().__init__()
        self.grid, self.ways, periodic = grid, ways, grid.periodic
        channels = 6 if ways else 3
        self.down = nn.ModuleList(
            [
                Block(4 * channels, width, periodic),
                Block(width, 2 * width, periodic),
                Block(2 * width, 2 * width, periodic),
            ]
        )
        self.up = nn.ModuleList([Block(4 * width, 2 * width, periodic), Block(3 * width, width, periodic)])
        self.last = nn.Sequential(
            WrappedConv(width // 4 + channels, 16, periodic), nn.LeakyReLU(0.1), nn.Conv2d(16, OUTPUTS, 1)
        )

    @property
    def maps(self) -> int:
        """How many maps it sees."""
        return 3 if self.ways else 1

    def forward(self, maps: Tensor, start: Tensor, goal: Tensor) -> CellMaps:
        """What it tells of every cell."""
        ends = torch.stack([self.grid.marks(start), self.grid.marks(goal)], dim=1)
        detour = [torch.exp(-maps[:, 1:2] / scale) for scale in DETOUR_RAD] if self.ways else []
        seen = torch.cat([maps[:, :1], ends, *detour, *([maps[:, 2:]] if self.ways else [])], dim=1)
        values, kept = functional.pixel_unshuffle(seen, 2), []
        for level, block in enumerate(self.down):
            values = block(values if level == 0 else functional.avg_pool2d(values, 2))
            kept.append(values)
        for block, beside in zip(self.up, (kept[1], kept[0]), strict=True):
            values = block(torch.cat([functional.interpolate(values, scale_factor=2.0), beside], dim=1))
        whole = self.last(torch.cat([functional.pixel_shuffle(values, 2), seen], dim=1))
        flat = whole.flatten(2)
        return CellMaps(flat[:, 0], flat[:, 1], flat[:, 2:].transpose(1, 2))


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
        fields: (T, 2, c, c) uint8, detour and progress of every path as :mod:`training.models.way_fields`
            stores them; None where the U-Net does not see them.
        space: the joint space.
        seed: of initialisation and of every draw.
    """

    maps: Tensor

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
        optimiser = torch.optim.Adam(self.parameters(), lr=config.learning_rate)
        self.training_optimisers = [optimiser]
        rate = torch.optim.lr_scheduler.OneCycleLR
        self.training_schedules = [
            rate(optimiser, config.learning_rate, total_steps=config.steps + 1, pct_start=0.1)
        ]

    def on_fit_start(self) -> None:
        """Keep the data where the model is."""
        self.samples = self.samples.to(self.device)
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
        loss = density + progress + offset
        (optimiser,) = self.training_optimisers
        optimiser.zero_grad()
        loss.backward()
        nn.utils.clip_grad_norm_(self.parameters(), 5.0)
        optimiser.step()
        self.training_schedules[0].step()
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
        return samples.unsqueeze(1)
