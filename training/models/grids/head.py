"""The head of a serial arm: P(free | array of space, configuration), and how much of the arm is unseen.

What is seen bounds the answer: distances to the surface seen are read at all spheres, and touching the arm
itself is told exactly. What is not seen is learned: features of the scene are read where groups of spheres
would be, each group's hazard is told, and pooled to the whole arm's.
"""

from dataclasses import dataclass

import torch
from torch import Tensor, nn
from torch.nn import functional

from cspace.errors import ConfigError
from cspace.world import GridArm, World
from training.models.grids.encoder import STRIDE, GridEncoder
from training.models.networks import mlp
from training.models.settings import GridConfig, ValidityConfig
from training.models.space.arm import ArmPoints, SelfGap, buffer
from training.models.space.reading import Points, table_of

_NAMES = 8
# Of a picture: distance to what is seen, and what is known.
_CHANNELS = 2
# Margins to what is seen that are told apart: about contact, and on the whole.
_SHARP_M, _NEAR_M, _FAR_M = 0.01, 0.03, 0.1
# Log odds of a group's hazard before anything is learned.
_RARE = -4.0


@dataclass(frozen=True, slots=True)
class Belief:
    """What the head says of configurations (p, c).

    Args:
        clear: (p, c) log of the probability that no obstacle is touched.
        hazards: (p, c, G) log odds that a group of spheres touches one.
        itself: (p, c) whether the arm does not touch itself.
        unseen: (p, c) share of the arm's volume that no camera saw to be free.
    """

    clear: Tensor
    hazards: Tensor
    itself: Tensor
    unseen: Tensor

    @property
    def free(self) -> Tensor:
        """(p, c): the probability of being free."""
        return self.clear.exp() * self.itself


class GridHead(nn.Module):
    """See the module; pictures are (p, 2, X, Y, Z) in [0, 1], configurations (p, c, d) rad."""

    moving: Tensor
    members: Tensor
    radii: Tensor
    volumes: Tensor
    low: Tensor
    farthest: Tensor

    def __init__(self, config: GridConfig, hidden: int, arm: GridArm, counts: tuple[int, int, int]) -> None:
        super().__init__()
        self.counts, self.scale_m = counts, 255.0 * arm.distance_step_m
        self.voxel_m, self.groups = arm.voxel_m, len(arm.group_links)
        self.encoder = GridEncoder(arm, config.width, config.middle, config.deep)
        self.points, self.gap = ArmPoints(arm), SelfGap(arm)
        moving = buffer(arm.links, torch.long) > 0
        places = torch.cumsum(moving, dim=0) - 1
        self.register_buffer("moving", torch.nonzero(moving)[:, 0])
        self.register_buffer("members", places[buffer(arm.members, torch.long)])
        self.register_buffer("radii", buffer(arm.spheres_m[:, 3])[moving])
        self.register_buffer("volumes", functional.normalize(self.radii**3, p=1.0, dim=0))
        self.register_buffer("low", buffer(arm.low_m)[:, None])
        self.register_buffer("farthest", _farthest(arm))
        self.names = nn.Parameter(0.1 * torch.randn(self.groups, _NAMES))
        # Features, place, place in the voxel, direction, three margins, five of sight, share unseen, name.
        told = config.width + 3 + 3 + 3 + 3 + 5 + 1 + _NAMES
        self.group = nn.Sequential(mlp(told, hidden, 1, hidden), nn.ReLU())
        self.hazard = nn.Linear(hidden, 1)
        nn.init.constant_(self.hazard.bias, _RARE)
        self.whole = mlp(2 * hidden + 3, hidden, 1, 1)
        self.seen = mlp(4, 16, 1, 1)

    @classmethod
    def of(cls, config: ValidityConfig, world: World) -> "GridHead":
        """The head that settings name.

        Raises:
            ConfigError: pictures of the world are no arrays of space, or the settings are of another head.
        """
        if config.grid is None:
            raise ConfigError(
                "a head of arrays of space needs its sizes", expected="validity.grid", got="none"
            )
        arm = world.grid_arm(config.grid.groups)
        x, y, z, _ = world.sensor.picture_shape
        return cls(config.grid, config.hidden, arm, (x, y, z))

    def encode(self, pictures: Tensor) -> Tensor:
        """Features of pictures, (p X Y Z / 64, C)."""
        return table_of(self.encoder(pictures)[0])

    def forward(self, pictures: Tensor, table: Tensor, configurations: Tensor) -> Belief:
        """What is believed of configurations."""
        scenes, count, dim = configurations.shape
        spheres, groups = self.points(configurations.reshape(-1, dim))
        margins, unseen = self._at_spheres(pictures, spheres, scenes)
        margins, unseen = margins.reshape(scenes * count, -1), unseen.reshape(scenes * count, -1)
        along = (spheres[:, :, self.farthest] - groups).transpose(1, 2) / _FAR_M
        read = self._at_groups(pictures, table, groups, along, scenes)
        near = margins[:, self.members].amin(dim=2)
        sight = unseen[:, self.members].mean(dim=2)
        told = torch.cat([read, _told(near), sight.unsqueeze(-1)], dim=2)
        told = torch.cat([told, self.names.expand(told.shape[0], -1, -1)], dim=2)
        inner = self.group(told)
        hazards = self.hazard(inner).squeeze(-1)
        share = (unseen * self.volumes).sum(dim=1)
        clear = self._clear(inner, hazards, share) + self._past_the_seen(margins)
        shape = (scenes, count)
        return Belief(
            clear.reshape(shape),
            hazards.reshape(scenes, count, -1),
            (self.gap(spheres) > 0.0).float().reshape(shape),
            share.reshape(shape),
        )

    def _at_spheres(self, pictures: Tensor, spheres: Tensor, scenes: int) -> tuple[Tensor, Tensor]:
        """Margins to the surface seen, m, and whether not seen free, of all spheres that move."""
        points = self._points(spheres[:, :, self.moving], scenes, self.counts, self.voxel_m, _CHANNELS)
        # Read where it lies: a channel of its own would be a copy, as large as all that is read of it.
        table = pictures.reshape(-1, 1)
        near = points.between(table).squeeze(-1) * self.scale_m
        codes = functional.embedding(points.nearest(1), table).squeeze(-1)
        margins = near.reshape(-1, len(self.radii)) - self.radii
        return margins, (codes > 0.5 / 255.0).float()

    def _at_groups(
        self, pictures: Tensor, table: Tensor, groups: Tensor, along: Tensor, scenes: int
    ) -> Tensor:
        """(n, G, ...): features, places, directions (n, G, 3), and what is known of the voxel."""
        counts = (self.counts[0] // STRIDE, self.counts[1] // STRIDE, self.counts[2] // STRIDE)
        coarse = self._points(groups, scenes, counts, STRIDE * self.voxel_m)
        rows = groups.shape[0]
        features = coarse.between(table).reshape(rows, self.groups, -1)
        inside = (coarse.places - coarse.places.floor() - 0.5).transpose(1, 2).reshape(rows, -1, 3)
        fine = self._points(groups, scenes, self.counts, self.voxel_m, _CHANNELS)
        code = functional.embedding(fine.nearest(1), pictures.reshape(-1, 1)).reshape(rows, -1, 1)
        free, out = (code < 0.5 / 255.0).float(), (code > 254.5 / 255.0).float()
        unread = ((code - self.encoder.no_reading).abs() < 0.5 / 255.0).float()
        hidden = 1.0 - free - out - unread
        places = groups.transpose(1, 2)
        return torch.cat([features, places, inside, along, free, unread, out, hidden, hidden * code], dim=2)

    def _points(
        self, points: Tensor, scenes: int, counts: tuple[int, int, int], voxel_m: float, channels: int = 1
    ) -> Points:
        """Points (n, 3, S) of so many scenes in a grid."""
        places = (points - self.low) / voxel_m
        flat = places.reshape(scenes, -1, 3, places.shape[2]).transpose(1, 2)
        return Points(flat.reshape(scenes, 3, -1), counts, channels)

    def _clear(self, inner: Tensor, hazards: Tensor, unseen: Tensor) -> Tensor:
        """Log probability that nothing is touched, as far as it is learned, (n,)."""
        together = torch.logsumexp(hazards, dim=1)
        worst = hazards.amax(dim=1)
        sums = torch.stack([together / 4.0, worst / 4.0, unseen], dim=1)
        pooled = self.whole(torch.cat([inner.amax(dim=1), inner.mean(dim=1), sums], dim=1)).squeeze(-1)
        return functional.logsigmoid(-together - pooled)

    def _past_the_seen(self, margins: Tensor) -> Tensor:
        """Log probability that the surface seen is not touched: by the two least margins alone, (n,)."""
        least = -torch.topk(-margins, 2, dim=1).values
        first = least[:, :1]
        told = [(least / _FAR_M).clamp(-1.0, 1.0), torch.tanh(first / _SHARP_M), torch.tanh(first / _NEAR_M)]
        return functional.logsigmoid(self.seen(torch.cat(told, dim=1)).squeeze(-1))


def _told(margins: Tensor) -> Tensor:
    """(n, G) m to (n, G, 3)."""
    scales = [
        (margins / _FAR_M).clamp(-1.0, 1.2),
        torch.tanh(margins / _SHARP_M),
        torch.tanh(margins / _NEAR_M),
    ]
    return torch.stack(scales, dim=2)


def _farthest(arm: GridArm) -> Tensor:
    """Of each group the sphere that is farthest from its centre, (G,)."""
    centres, spheres = buffer(arm.group_spheres_m[:, :3]), buffer(arm.spheres_m[:, :3])
    members = buffer(arm.members, torch.long)
    farthest = (spheres[members] - centres[:, None]).norm(dim=2).argmax(dim=1, keepdim=True)
    return torch.gather(members, 1, farthest)[:, 0]
