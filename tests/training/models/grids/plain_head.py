"""What a head says, computed straight on: what is quicker is held to it."""

from collections.abc import Callable

import torch
from torch import Tensor, nn
from torch.nn import functional

from cspace.world import GridArm
from training.models.grid_head import GridHead
from training.models.kinematics import ArmFrames, buffer, frame_rows


class ArmPoints(nn.Module):
    """Configurations (n, d) rad to the spheres' centres (n, 3, S) m and those of their groups (n, 3, G)."""

    rows: Tensor

    def __init__(self, arm: GridArm) -> None:
        super().__init__()
        self.frames, self.spheres = ArmFrames(arm), len(arm.links)
        points = torch.cat([buffer(arm.spheres_m[:, :3]), buffer(arm.group_spheres_m[:, :3])])
        links = torch.cat([buffer(arm.links, torch.long), buffer(arm.group_links, torch.long)])
        self.register_buffer("rows", frame_rows(points, links, len(arm.axes) + 1), persistent=False)

    def forward(self, configurations: Tensor) -> tuple[Tensor, Tensor]:
        """Spheres and groups."""
        points = (self.rows @ self.frames(configurations)).permute(2, 0, 1)
        return points[:, :, : self.spheres], points[:, :, self.spheres :]


class Points:
    """Points of several scenes in one grid.

    Args:
        places: (p, 3, n) in voxels from the lowest corner.
        counts: X, Y, Z of the grid.
        channels: that lie one behind the other in each scene's part of a table, as a picture (p, C, X, Y, Z)
            that is only reshaped has them.
        scenes: (p,) their numbers in the table; None for all in their order.
    """

    def __init__(
        self,
        places: Tensor,
        counts: tuple[int, int, int],
        channels: int = 1,
        scenes: Tensor | None = None,
    ) -> None:
        self.places, self.counts = places, counts
        self.voxels = counts[0] * counts[1] * counts[2]
        numbers = torch.arange(places.shape[0], device=places.device) if scenes is None else scenes
        self.rows = numbers[:, None] * (channels * self.voxels)

    def interpolate(
        self, table: Tensor, channel: int = 0, transform: Callable[[Tensor], Tensor] | None = None
    ) -> Tensor:
        """Trilinear between voxels, (p, n, C), of a table (p X Y Z, C) or of one of its channels.

        Args:
            table: rows of all voxels.
            channel: which, where several lie one behind the other.
            transform: what becomes of rows (p, n, C) before they are mixed; None for themselves.
        """
        firsts, shares = [], []
        for axis in range(3):
            middle = (self.places[:, axis] - 0.5).clamp(0.0, self.counts[axis] - 1.001)
            first = middle.long()
            firsts.append(first)
            shares.append((middle - first).unsqueeze(-1))
        start = (firsts[0] * self.counts[1] + firsts[1]) * self.counts[2] + firsts[2] + self.rows
        start = start + channel * self.voxels if channel else start
        steps = (self.counts[1] * self.counts[2], self.counts[2], 1)

        def along(axis: int, at: Tensor) -> Tensor:
            if axis == 3:
                rows = functional.embedding(at, table)
                return rows if transform is None else transform(rows)
            low = along(axis + 1, at)
            return low + shares[axis] * (along(axis + 1, at + steps[axis]) - low)

        return along(0, start)


def plain_answers(head: GridHead, arm: GridArm, picture: Tensor, rows: Tensor) -> tuple[Tensor, Tensor]:
    """P(free of obstacles) and unseen share, (n,), for one picture (1, 2, X, Y, Z) and (n, d) rad."""
    spheres, groups = ArmPoints(arm)(rows)
    moving = buffer(arm.links, torch.long) > 0
    margins, unseen = at_spheres(head, arm, picture, spheres[:, :, moving])
    places = torch.cumsum(moving, dim=0) - 1
    members = places[buffer(arm.members, torch.long)]
    near, sight = margins[:, members].amin(dim=2), unseen[:, members].mean(dim=2)
    inputs = torch.cat(
        [at_groups(head, arm, picture, spheres, groups), scales(near), sight[..., None]], dim=2
    )
    model = head.model
    inner = model.group(torch.cat([inputs, head.shapes.expand(len(rows), -1, -1)], dim=2))
    hazards = model.hazard(inner).squeeze(-1)
    volumes = functional.normalize(buffer(arm.spheres_m[:, 3])[moving] ** 3, p=1.0, dim=0)
    share = (unseen * volumes).sum(dim=1)
    together, worst = torch.logsumexp(hazards, dim=1), hazards.amax(dim=1)
    sums = torch.stack([together / 4.0, worst / 4.0, share], dim=1)
    pooled = model.whole(torch.cat([inner.amax(dim=1), inner.mean(dim=1), sums], dim=1)).squeeze(-1)
    least = -torch.topk(-margins, 2, dim=1).values
    first = least[:, :1]
    seen = torch.cat(
        [(least / 0.1).clamp(-1.0, 1.0), torch.tanh(first / 0.01), torch.tanh(first / 0.03)], dim=1
    )
    past = functional.logsigmoid(model.seen(seen).squeeze(-1))
    return (functional.logsigmoid(-together - pooled) + past).exp(), share


def at_spheres(head: GridHead, arm: GridArm, picture: Tensor, spheres: Tensor) -> tuple[Tensor, Tensor]:
    """Margins to the surface seen, m, and whether not seen free, (n, S)."""
    points = grid_points(arm, spheres, head.counts, arm.voxel_m, 2)
    table = picture.reshape(-1, 1)
    near = points.interpolate(table).reshape(len(spheres), -1) * 255.0 * arm.distance_step_m
    codes = table[nearest(points, 1)].reshape(len(spheres), -1)
    radii = buffer(arm.spheres_m[arm.links > 0, 3])
    return near - radii, (codes > 0.5 / 255.0).float()


def at_groups(head: GridHead, arm: GridArm, picture: Tensor, spheres: Tensor, groups: Tensor) -> Tensor:
    """All but margins, sight and names, (n, G, k)."""
    rows, x, y, z = len(groups), *(count // head.stride for count in head.counts)
    coarse = grid_points(arm, groups, (x, y, z), head.stride * arm.voxel_m)
    features = coarse.interpolate(head.encode(picture)).reshape(rows, head.groups, -1)
    inside = (coarse.places - coarse.places.floor() - 0.5).reshape(3, rows, -1).permute(1, 2, 0)
    fine = grid_points(arm, groups, head.counts, arm.voxel_m, 2)
    code = picture.reshape(-1)[nearest(fine, 1)].reshape(rows, -1, 1)
    free, out = (code < 0.5 / 255.0).float(), (code > 254.5 / 255.0).float()
    unread = ((code - arm.no_reading / 255.0).abs() < 0.5 / 255.0).float()
    hidden = 1.0 - free - out - unread
    members, centres = buffer(arm.members, torch.long), buffer(arm.group_spheres_m[:, :3])
    gaps = (buffer(arm.spheres_m[:, :3])[members] - centres[:, None]).norm(dim=2)
    farthest = torch.gather(members, 1, gaps.argmax(dim=1, keepdim=True))[:, 0]
    along = (spheres[:, :, farthest] - groups).transpose(1, 2) / 0.1
    places = groups.transpose(1, 2)
    return torch.cat([features, places, inside, along, free, unread, out, hidden, hidden * code], dim=2)


def grid_points(
    arm: GridArm, points: Tensor, counts: tuple[int, int, int], voxel_m: float, channels: int = 1
) -> Points:
    """Points (n, 3, k) in a grid."""
    places = (points - buffer(arm.low_m)[:, None]) / voxel_m
    return Points(places.transpose(0, 1).reshape(1, 3, -1), counts, channels)


def nearest(points: Points, channel: int) -> Tensor:
    """(p, n): rows of a channel for the voxels that points lie in, or for the nearest ones."""
    x, y, z = (
        points.places[:, axis].clamp(0.0, float(count - 1)).long() for axis, count in enumerate(points.counts)
    )
    numbers = (x * points.counts[1] + y) * points.counts[2] + z
    return numbers + points.rows + channel * points.voxels


def scales(margins: Tensor) -> Tensor:
    """(n, G) m to (n, G, 3)."""
    return torch.stack(
        [(margins / 0.1).clamp(-1.0, 1.2), torch.tanh(margins / 0.01), torch.tanh(margins / 0.03)], dim=2
    )
