"""The validity head of a serial arm: P(free | array of space, configuration), and the unseen share."""

from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor, nn
from torch.nn import functional

from cspace.world import GridArm, World
from training.config import GridConfig, ValidityConfig
from training.models.joints import table_of
from training.models.kinematics import ArmFrames, SelfGap, buffer, frame_rows
from training.models.modules import mlp

Counts = tuple[int, int, int]


class Corners:
    """The eight voxels round each point, and its place between them.

    ``places`` (3, k, n) in voxels from the lowest corner; ``rows`` (n,) where in a table each
    configuration's scene begins; one number for all.
    """

    def __init__(self, places: Tensor, counts: Counts, rows: Tensor | int) -> None:
        last = torch.tensor(counts, dtype=places.dtype, device=places.device).reshape(3, 1, 1) - 1.001
        middle = torch.minimum((places - 0.5).clamp(min=0.0), last)
        first = middle.floor()
        self.start = _numbers(first, counts, rows)
        self.shares = (middle - first).unbind(dim=0)
        self.steps = (counts[1] * counts[2], counts[2], 1)

    def of_values(self, table: Tensor) -> Tensor:
        """Trilinear between single values, (k, n), of a table (m,)."""
        x, y, z = self.steps
        steps = torch.tensor([a + b + c for c in (0, z) for b in (0, y) for a in (0, x)])
        at = self.start + steps.to(self.start.device).reshape(-1, 1, 1)
        # Picked one by one, which a graph does in a seventh of the time of reading rows of a single value.
        found = torch.gather(table, 0, at.reshape(-1)).reshape(at.shape)
        for share, count in zip(self.shares[::-1], (4, 2, 1), strict=True):
            low, high = found[:count], found[count:]
            found = low + share * (high - low)
        return found[0]

    def of_rows(self, table: Tensor) -> Tensor:
        """Trilinear between rows, (k n, C), of a table (m, C)."""
        start = self.start.reshape(-1)
        # As wide as the rows by a product, for a graph multiplies what is as large far quicker.
        wide = table.new_ones(1, table.shape[1])
        shares = [share.reshape(-1, 1) @ wide for share in self.shares]

        def along(axis: int, at: Tensor) -> Tensor:
            if axis == len(shares):
                return functional.embedding(at, table)
            low = along(axis + 1, at)
            return low + shares[axis] * (along(axis + 1, at + self.steps[axis]) - low)

        return along(0, start)


def nearest_value(table: Tensor, places: Tensor, counts: Counts, rows: Tensor | int) -> Tensor:
    """The value of the voxel that each point lies in, or of the nearest one, (k, n), of a table (m,)."""
    last = torch.tensor(counts, dtype=places.dtype, device=places.device).reshape(3, 1, 1) - 1.0
    at = _numbers(torch.minimum(places.clamp(min=0.0), last).floor(), counts, rows)
    return torch.gather(table, 0, at.reshape(-1)).reshape(at.shape)


def _numbers(voxels: Tensor, counts: Counts, rows: Tensor | int) -> Tensor:
    """Whole places (3, k, n) to rows of a table, (k, n): below 2^24, so that floats tell them exactly."""
    at = ((voxels[0] * counts[1] + voxels[1]) * counts[2] + voxels[2]).long()
    return at if isinstance(rows, int) and rows == 0 else at + rows


# What a voxel of 5 cm says: nearest surface; seen free, no reading, out of view, hidden; how far behind.
CHANNELS = 6
_HALF = 0.5 / 255.0


class _Residual(nn.Module):
    def __init__(self, width: int) -> None:
        super().__init__()
        self.first, self.second = (nn.Conv3d(width, width, 3, padding=1) for _ in range(2))
        self.norm = nn.GroupNorm(4, width)

    def forward(self, features: Tensor) -> Tensor:
        inner = functional.relu(self.norm(self.first(functional.relu(features))))
        found: Tensor = features + self.second(inner)
        return found


# About the middle of where an arm works; with it, inputs are small.
_MIDDLE_M = (0.0, 0.0, 0.333)


class GridEncoder(nn.Module):
    """Pictures (p, 2, X, Y, Z) in [0, 1] to features (p, C, X / s, Y / s, Z / s) with :attr:`stride` s.

    A U-net of three scales, or four: each sees more of the scene than the one before.
    """

    def __init__(self, arm: GridArm, config: GridConfig) -> None:
        super().__init__()
        finest, width, middle, deep = config.finest, config.width, config.middle, config.deep
        self.no_reading = arm.no_reading / 255.0
        self.stride, self.channels = (2, finest) if finest else (4, width)
        # Of a voxel of the second scale.
        self.cell_m = 4.0 * arm.voxel_m
        self.has_finest = finest > 0
        if finest:
            self.enter = nn.Conv3d(CHANNELS, finest, 3, padding=1)
            self.finest, self.finest_again = _Residual(finest), _Residual(finest)
            self.leave = nn.Conv3d(width, finest, 1)
        self.into = nn.Conv3d(finest or CHANNELS, width, 2, stride=2)
        self.where = nn.Conv3d(3, width, 1)
        self.fine, self.fine_again = _Residual(width), _Residual(width)
        self.down, self.up = nn.Conv3d(width, middle, 2, stride=2), nn.Conv3d(middle, width, 1)
        self.middle, self.middle_again = _Residual(middle), _Residual(middle)
        self.deeper, self.out_of_deep = nn.Conv3d(middle, deep, 2, stride=2), nn.Conv3d(deep, middle, 1)
        self.deep = _Residual(deep)

    def forward(self, pictures: Tensor, low: Tensor) -> Tensor:
        """Features; ``low`` (3,) m is the grid's lowest corner in the base frame."""
        finest = self._channels(pictures)
        if self.has_finest:
            finest = self.finest(self.enter(finest))
        # In the base frame, so that the grids of all arms say the same.
        steps = [
            self.cell_m * (torch.arange(size // 2, device=low.device) + 0.5) for size in finest.shape[2:]
        ]
        axes = [low[axis] - _MIDDLE_M[axis] + step for axis, step in enumerate(steps)]
        places = torch.stack(torch.meshgrid(*axes, indexing="ij")).unsqueeze(0)
        into = functional.relu(finest) if self.has_finest else finest
        fine = self.fine(self.into(into) + self.where(places))
        middle = self.middle(self.down(functional.relu(fine)))
        deep = self.deep(self.deeper(functional.relu(middle)))
        middle = self.middle_again(middle + _doubled(self.out_of_deep(functional.relu(deep))))
        fine = functional.relu(self.fine_again(fine + _doubled(self.up(functional.relu(middle)))))
        if self.has_finest:
            fine = functional.relu(self.finest_again(finest + _doubled(self.leave(fine))))
        return fine

    def _channels(self, pictures: Tensor) -> Tensor:
        near, code = pictures[:, :1], pictures[:, 1:]
        free, out = (code < _HALF).float(), (code > 1.0 - _HALF).float()
        unread = ((code - self.no_reading).abs() < _HALF).float()
        hidden = 1.0 - free - out - unread
        pooled = functional.avg_pool3d(torch.cat([free, unread, out, hidden, hidden * code], dim=1), 2)
        return torch.cat([-functional.max_pool3d(-near, 2), pooled], dim=1)


def _doubled(features: Tensor) -> Tensor:
    doubled: Tensor = functional.interpolate(features, scale_factor=2.0, mode="nearest")
    return doubled


# Of a picture: distance to what is seen, and what is known.
_CHANNELS = 2
# Margins to what is seen that are told apart: about contact, and on the whole.
_SHARP_M, _NEAR_M, _FAR_M = 0.01, 0.03, 0.1
# Log odds of a group's hazard before anything is learned.
_RARE = -4.0


@dataclass(frozen=True, slots=True)
class HeadPrediction:
    """What the head says of configurations (p, c)."""

    clear: Tensor  # (p, c) log of the probability that no obstacle is touched
    hazards: Tensor  # (p, c, G) log odds that a group of spheres touches one
    itself: Tensor  # (p, c) whether the arm does not touch itself
    unseen: Tensor  # (p, c) share of the arm's volume that no camera saw to be free

    @property
    def free(self) -> Tensor:
        """(p, c): the probability of being free."""
        return self.clear.exp() * self.itself


# What a group of spheres is told by.
_SHAPE = 6


class SceneModel(nn.Module):
    """All that a head learns: what a picture says of space, and what that means to groups of spheres.

    It knows no arm, so that what it learned with some serves others (:meth:`GridHead.of`).
    """

    def __init__(self, config: GridConfig, hidden: int, arm: GridArm) -> None:
        super().__init__()
        self.config, self.hidden, self.voxel_m = config, hidden, arm.voxel_m
        self.encoder = GridEncoder(arm, config)
        # Features, place, place in the voxel, direction, three margins, five of sight, share unseen, shape.
        inputs = self.encoder.channels + 3 + 3 + 3 + 3 + 5 + 1 + _SHAPE
        self.group = nn.Sequential(mlp(inputs, hidden, 1, hidden), nn.ReLU())
        self.hazard = nn.Linear(hidden, 1)
        nn.init.constant_(self.hazard.bias, _RARE)
        self.whole = mlp(2 * hidden + 3, hidden, 1, 1)
        self.seen = mlp(4, 16, 1, 1)


class GridHead(nn.Module):
    """See the module; pictures are (p, 2, X, Y, Z) in [0, 1], configurations (p, c, d) rad."""

    spheres: Tensor
    shapes: Tensor
    low: Tensor
    group_voxels: Tensor
    group_places: Tensor
    group_ways: Tensor
    corner: Tensor
    members: Tensor
    radii: Tensor
    volumes: Tensor

    def __init__(self, model: SceneModel, arm: GridArm, counts: Counts) -> None:
        super().__init__()
        self.model, self.counts, self.scale_m = model, counts, 255.0 * arm.distance_step_m
        self.stride = model.encoder.stride
        self.voxel_m, self.groups = arm.voxel_m, len(arm.group_links)
        self.frames, self.gap = ArmFrames(arm), SelfGap(arm)
        moving = buffer(arm.links, torch.long) > 0
        radii = buffer(arm.spheres_m[:, 3])[moving][:, None]
        places = torch.cumsum(moving, dim=0) - 1
        rows = _rows(arm, moving) | {
            # Of the base's origin, in voxels from the grid's lowest corner.
            "corner": -buffer(arm.low_m)[:, None, None] / arm.voxel_m,
            "low": buffer(arm.low_m),
            "members": places[buffer(arm.members, torch.long)],
            "radii": radii,
            "volumes": functional.normalize(radii**3, p=1.0, dim=0),
            "shapes": _shapes(arm),
        }
        for name, row in rows.items():
            self.register_buffer(name, row, persistent=False)

    @classmethod
    def of(cls, config: ValidityConfig, world: World) -> "GridHead":
        """The head that settings name."""
        grid = config.grid or GridConfig()
        arm = world.grid_arm(grid.groups)
        return cls(SceneModel(grid, config.hidden, arm), arm, counts_of(world))

    def encode(self, pictures: Tensor) -> Tensor:
        """Features of pictures, (p X Y Z / s^3, C)."""
        return table_of(self.model.encoder(pictures, self.low))

    def forward(self, pictures: Tensor, table: Tensor, configurations: Tensor) -> HeadPrediction:
        """Predicts validity, and what is hidden, of configurations."""
        scenes, count, dim = configurations.shape
        frames = self.frames(configurations.reshape(-1, dim))
        scene = None if scenes == 1 else torch.arange(scenes, device=frames.device).repeat_interleave(count)
        shape = (scenes, count)
        margins, unseen = self.at_spheres(pictures, frames, scene)
        near, sight = margins[self.members].amin(dim=1), unseen[self.members].mean(dim=1)
        inputs = [*self._at_groups(pictures, frames, scene), *_margin_features(near), sight.unsqueeze(0)]
        features = self._features(table, frames, scene).T.reshape(-1, *near.shape)
        shapes = self.shapes.T.unsqueeze(-1).expand(-1, -1, near.shape[1])
        inner = self._inner(torch.cat([features, *inputs, shapes]))
        hazards = _through(self.model.hazard, inner)[0]
        # The sum of all volumes may be above 1 by rounding.
        share = (unseen * self.volumes).sum(dim=0).clamp(max=1.0)
        clear = self._clear(inner, hazards, share) + self._past_the_seen(margins)
        return HeadPrediction(
            clear.reshape(shape),
            hazards.T.reshape(*shape, -1),
            (self.gap(frames) > 0.0).float().reshape(shape),
            share.reshape(shape),
        )

    def at_spheres(self, pictures: Tensor, frames: Tensor, scene: Tensor | None) -> tuple[Tensor, Tensor]:
        """Of all spheres that move, (S, n): margins to the surface seen, m, and whether not seen free.

        ``pictures`` (p, 2, X, Y, Z) in [0, 1]; ``scene`` (n,) number of the picture; None for one.
        """
        places, values = self.spheres @ frames + self.corner, pictures.reshape(-1)
        near = Corners(places, self.counts, self._begin(scene)).of_values(values)
        codes = nearest_value(values, places, self.counts, self._begin(scene, 1))
        return near * self.scale_m - self.radii, (codes > 0.5 / 255.0).float()

    def _begin(self, scene: Tensor | None, channel: int = 0) -> Tensor | int:
        """Where in all pictures a channel of a scene begins."""
        voxels = self.counts[0] * self.counts[1] * self.counts[2]
        return channel * voxels + (0 if scene is None else scene * (_CHANNELS * voxels))

    def _features(self, table: Tensor, frames: Tensor, scene: Tensor | None) -> Tensor:
        """What the map says at groups, (G n, C)."""
        x, y, z = (count // self.stride for count in self.counts)
        coarse = (self.group_voxels @ frames + self.corner) / self.stride
        return Corners(coarse, (x, y, z), 0 if scene is None else scene * (x * y * z)).of_rows(table)

    def _at_groups(self, pictures: Tensor, frames: Tensor, scene: Tensor | None) -> list[Tensor]:
        """Each (..., G, n): places, m, places in the voxel, directions, and what is known of the voxel."""
        places = self.group_voxels @ frames + self.corner
        coarse = places / self.stride
        inside = coarse - coarse.floor() - 0.5
        code = nearest_value(pictures.reshape(-1), places, self.counts, self._begin(scene, 1)).unsqueeze(0)
        free, out = (code < 0.5 / 255.0).float(), (code > 254.5 / 255.0).float()
        unread = ((code - self.model.encoder.no_reading).abs() < 0.5 / 255.0).float()
        hidden = 1.0 - free - out - unread
        directions = self.group_ways @ frames
        return [self.group_places @ frames, inside, directions, free, unread, out, hidden, hidden * code]

    def _inner(self, inputs: Tensor) -> Tensor:
        """What is made of all that is told of groups, (k, G, n) to (H, G, n)."""
        first, bent, second = (self.model.group.get_submodule(f"0.{number}") for number in range(3))
        return functional.relu(_through(second, bent(_through(first, inputs))))

    def _clear(self, inner: Tensor, hazards: Tensor, unseen: Tensor) -> Tensor:
        """Log probability that nothing is touched, as far as it is learned, (n,)."""
        together = torch.logsumexp(hazards, dim=0)
        worst = hazards.amax(dim=0)
        sums = torch.stack([together / 4.0, worst / 4.0, unseen])
        features = torch.cat([inner.amax(dim=1), inner.mean(dim=1), sums])
        return functional.logsigmoid(-together - self.model.whole(features.T).squeeze(-1))

    def _past_the_seen(self, margins: Tensor) -> Tensor:
        """Log probability that the surface seen is not touched: by the two least margins alone, (n,)."""
        least = -torch.topk(-margins.T, 2, dim=1).values
        first = least[:, :1]
        features = [
            (least / _FAR_M).clamp(-1.0, 1.0),
            torch.tanh(first / _SHARP_M),
            torch.tanh(first / _NEAR_M),
        ]
        return functional.logsigmoid(self.model.seen(torch.cat(features, dim=1)).squeeze(-1))


def _through(layer: nn.Module, inner: Tensor) -> Tensor:
    """A linear layer along the first axis, (C, G, n) to (D, G, n)."""
    assert isinstance(layer, nn.Linear)  # noqa: S101 - for the type checker
    found = layer.weight @ inner.flatten(1) + layer.bias[:, None]
    return found.reshape(-1, *inner.shape[1:])


def _margin_features(margins: Tensor) -> list[Tensor]:
    """(G, n) m to three of (1, G, n)."""
    scales = [
        (margins / _FAR_M).clamp(-1.0, 1.2),
        torch.tanh(margins / _SHARP_M),
        torch.tanh(margins / _NEAR_M),
    ]
    return [scale.unsqueeze(0) for scale in scales]


def _rows(arm: GridArm, moving: Tensor) -> dict[str, Tensor]:
    """What takes frames to points: spheres that move and groups and groups in voxels, groups in m, axes."""
    links, groups = buffer(arm.links, torch.long), buffer(arm.group_links, torch.long)
    spheres, centres = buffer(arm.spheres_m[:, :3]), buffer(arm.group_spheres_m[:, :3])
    count, step = len(arm.axes) + 1, 1.0 / arm.voxel_m
    farthest = _farthest(arm)
    return {
        "spheres": frame_rows(spheres[moving] * step, links[moving], count, step),
        "group_voxels": frame_rows(centres * step, groups, count, step),
        "group_places": frame_rows(centres, groups, count),
        "group_ways": frame_rows((spheres[farthest] - centres) / _FAR_M, groups, count, 0.0),
    }


def counts_of(world: World) -> Counts:
    """X, Y, Z of a world's pictures."""
    x, y, z, _ = world.sensor.picture_shape
    return (x, y, z)


def _shapes(arm: GridArm) -> Tensor:
    """What each group of spheres is like, (G, 6), all in 10 cm.

    The radius of what holds it; mean, least and largest of its spheres' radii; and how far their centres are
    spread along the two longest axes.
    """
    found = []
    for members, held in zip(arm.members, arm.group_spheres_m, strict=True):
        spheres = arm.spheres_m[np.unique(members)]
        centres = spheres[:, :3] - spheres[:, :3].mean(axis=0)
        spread = np.zeros(3)
        spread[: min(centres.shape)] = np.linalg.svd(centres, compute_uv=False) / np.sqrt(len(spheres))
        radii = spheres[:, 3]
        found.append([held[3], radii.mean(), radii.min(), radii.max(), *spread[:2]])
    return buffer(np.asarray(found) / _FAR_M)


def _farthest(arm: GridArm) -> Tensor:
    """Of each group the sphere that is farthest from its centre, (G,)."""
    centres, spheres = buffer(arm.group_spheres_m[:, :3]), buffer(arm.spheres_m[:, :3])
    members = buffer(arm.members, torch.long)
    farthest = (spheres[members] - centres[:, None]).norm(dim=2).argmax(dim=1, keepdim=True)
    return torch.gather(members, 1, farthest)[:, 0]
