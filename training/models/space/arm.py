"""Forward kinematics of a serial arm to the spheres that cover it, and whether these touch each other."""

import torch
from torch import Tensor, nn

from cspace.world import GridArm


def buffer(values: object, dtype: torch.dtype = torch.float32) -> Tensor:
    """An array of numpy as a tensor of its own."""
    return torch.tensor(values, dtype=dtype)


class ArmFrames(nn.Module):
    """Configurations (n, d) rad to the frames of an arm's links, (3, 4 (d + 1), n).

    Of each link the three columns of its turn and its place, m, one behind the other. Configurations come
    last, so that a graph computes with long rows; a joint costs it one product.
    """

    ahead: Tensor
    base: Tensor

    def __init__(self, arm: GridArm) -> None:
        super().__init__()
        turns, steps = buffer(arm.origins[:, :3, :3]), buffer(arm.origins[:, :3, 3:])
        cross = _cross(buffer(arm.axes))
        square = cross @ cross
        # A turn by an angle is 1 + K^2 + sin K - cos K^2: its three parts behind the joint's own place.
        still = torch.eye(3) + square
        ahead = torch.cat([turns @ still, turns @ cross, -turns @ square, steps], dim=2)
        self.register_buffer("ahead", ahead.transpose(1, 2).contiguous())
        self.register_buffer("base", torch.cat([torch.eye(3), torch.zeros(3, 1)], dim=1).unsqueeze(-1))

    def forward(self, configurations: Tensor) -> Tensor:
        """Frames."""
        angles = configurations.T
        sines, cosines = torch.sin(angles), torch.cos(angles)
        turn, place = self.base[:, :3], self.base.new_zeros(3, 1, 1)
        found = [self.base.expand(3, 4, configurations.shape[0])]
        for joint, ahead in enumerate(self.ahead):
            still, sine, cosine, step = torch.split(ahead @ turn, [3, 3, 3, 1], dim=1)
            turn = still + sines[joint] * sine + cosines[joint] * cosine
            place = place + step
            found += [turn, place.expand(3, 1, configurations.shape[0])]
        return torch.cat(found, dim=1)


def frame_rows(points: Tensor, links: Tensor, count: int, places: float = 1.0) -> Tensor:
    """What a product with frames (3, 4 c, n) takes to points: (k, 4 c) for points (k, 3) of links (k,).

    Args:
        points: in the links' frames.
        links: their numbers.
        count: c of the links, the base included.
        places: what the links' places are multiplied by; 0 for directions.
    """
    rows = points.new_zeros(len(points), count, 4)
    numbers = torch.arange(len(points))
    rows[numbers, links, :3] = points
    rows[numbers, links, 3] = places
    return rows.reshape(len(points), -1)


class ArmPoints(nn.Module):
    """Configurations (n, d) rad to the spheres' centres (n, 3, S) m and those of their groups (n, 3, G)."""

    rows: Tensor

    def __init__(self, arm: GridArm) -> None:
        super().__init__()
        self.frames, self.spheres = ArmFrames(arm), len(arm.links)
        points = torch.cat([buffer(arm.spheres_m[:, :3]), buffer(arm.group_spheres_m[:, :3])])
        links = torch.cat([buffer(arm.links, torch.long), buffer(arm.group_links, torch.long)])
        self.register_buffer("rows", frame_rows(points, links, len(arm.axes) + 1))

    def forward(self, configurations: Tensor) -> tuple[Tensor, Tensor]:
        """Spheres and groups."""
        points = (self.rows @ self.frames(configurations)).permute(2, 0, 1)
        return points[:, :, : self.spheres], points[:, :, self.spheres :]


class SelfGap(nn.Module):
    """Whether an arm touches itself, exactly, by its spheres.

    For spheres of centres a and b and radii r and s, the difference of squares (a - b)^2 - (r + s)^2 is a
    product of six numbers of either, so that all pairs of two sets are one product of matrices.
    """

    radii: Tensor

    def __init__(self, arm: GridArm) -> None:
        super().__init__()
        self.register_buffer("radii", buffer(arm.spheres_m[:, 3]))
        for number, sets in enumerate(arm.touching):
            for side, spheres in zip(("first", "second"), sets, strict=True):
                self.register_buffer(f"{side}_{number}", buffer(spheres, torch.long))
        self.count = len(arm.touching)

    def forward(self, centres: Tensor) -> Tensor:
        """Least difference of squares over all pairs, (n,) m2, for centres (n, 3, S); above 0 if free."""
        square = (centres * centres).sum(dim=1, keepdim=True)
        radii = self.radii.expand_as(square[:, 0]).unsqueeze(1)
        one, rest = torch.ones_like(square), square - radii * radii
        left = torch.cat([-2.0 * centres, rest, one, -2.0 * radii], dim=1)
        right = torch.cat([centres, one, rest, radii], dim=1)
        least = [torch.full_like(square[:, 0, 0], 1.0)]
        for number in range(self.count):
            first, second = (getattr(self, f"{side}_{number}") for side in ("first", "second"))
            gaps = left[:, :, first].transpose(1, 2) @ right[:, :, second]
            least.append(gaps.amin(dim=(1, 2)))
        return torch.stack(least).amin(dim=0)


def _cross(axes: Tensor) -> Tensor:
    """Matrices (d, 3, 3) of the cross product with each of (d, 3)."""
    x, y, z = axes.T
    zero = torch.zeros_like(x)
    rows = [[zero, -z, y], [z, zero, -x], [-y, x, zero]]
    return torch.stack([torch.stack(row, dim=1) for row in rows], dim=1)
