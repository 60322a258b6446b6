"""Forward kinematics of a serial arm to the spheres that cover it, and whether these touch each other."""

import torch
from torch import Tensor, nn

from cspace.world import GridArm


def buffer(values: object, dtype: torch.dtype = torch.float32) -> Tensor:
    """An array of numpy as a tensor of its own."""
    return torch.tensor(values, dtype=dtype)


class ArmPoints(nn.Module):
    """Configurations (n, d) rad to the spheres' centres (n, 3, S) m and those of their groups (n, 3, G).

    The same product serves all points of a link, so that a graph of it is small and quick.
    """

    points: Tensor
    sphere_places: Tensor
    group_places: Tensor
    turns: Tensor
    steps: Tensor
    cross: Tensor

    def __init__(self, arm: GridArm) -> None:
        super().__init__()
        spheres, groups = len(arm.links), len(arm.group_links)
        points = torch.cat([buffer(arm.spheres_m[:, :3]), buffer(arm.group_spheres_m[:, :3])])
        links = torch.cat([buffer(arm.links, torch.long), buffer(arm.group_links, torch.long)])
        order = torch.argsort(links, stable=True)
        self.sizes = [int((links == link).sum()) for link in range(len(arm.axes) + 1)]
        place = torch.argsort(order)
        self.register_buffer("points", points[order].T.contiguous())
        self.register_buffer("sphere_places", place[:spheres])
        self.register_buffer("group_places", place[spheres : spheres + groups])
        self.register_buffer("turns", buffer(arm.origins[:, :3, :3]))
        self.register_buffer("steps", buffer(arm.origins[:, :3, 3:]))
        self.register_buffer("cross", _cross(buffer(arm.axes)))

    def forward(self, configurations: Tensor) -> tuple[Tensor, Tensor]:
        """Spheres and groups."""
        count = configurations.shape[0]
        still = torch.eye(3, dtype=configurations.dtype, device=configurations.device)
        turn, place = still.expand(count, 3, 3), self.points.new_zeros(1, 3, 1)
        parts = torch.split(self.points, self.sizes, dim=1)
        found = [parts[0].unsqueeze(0).expand(count, 3, self.sizes[0])]
        sines, cosines = torch.sin(configurations), 1.0 - torch.cos(configurations)
        for joint, part in enumerate(parts[1:]):
            cross = self.cross[joint]
            own = still + sines[:, joint, None, None] * cross
            own = own + cosines[:, joint, None, None] * (cross @ cross)
            place = place + turn @ self.steps[joint]
            turn = (turn @ self.turns[joint]) @ own
            found.append(turn @ part + place)
        points = torch.cat(found, dim=2)
        return points[:, :, self.sphere_places], points[:, :, self.group_places]


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
