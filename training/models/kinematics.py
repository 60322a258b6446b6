"""Forward kinematics of a serial arm to its spheres in torch, and whether these touch each other."""

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn

from cspace.world import GridArm

# Of two sets of spheres so many pairs are all looked at in the time that balls round them take.
_MANY_PAIRS = 4000
# Spheres in a ball at most, and how much larger it is than they ask for, so that rounding is no matter.
_IN_A_BALL, _BALL_ROOM_M = 8, 1e-4


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
        self.register_buffer("ahead", ahead.transpose(1, 2).contiguous(), persistent=False)
        self.register_buffer(
            "base", torch.cat([torch.eye(3), torch.zeros(3, 1)], dim=1).unsqueeze(-1), persistent=False
        )

    def forward(self, configurations: Tensor) -> Tensor:
        """Frames."""
        angles = configurations.T
        sines, cosines = torch.split(torch.sin(angles), 1), torch.split(torch.cos(angles), 1)
        turn, place = self.base[:, :3], self.base.new_zeros(3, 1, 1)
        found = [self.base.expand(3, 4, configurations.shape[0])]
        for joint, ahead in enumerate(self.ahead):
            still, sine, cosine, step = torch.split(ahead @ turn, [3, 3, 3, 1], dim=1)
            turn = still + sines[joint] * sine + cosines[joint] * cosine
            place = place + step
            found += [turn, place.expand(3, 1, configurations.shape[0])]
        return torch.cat(found, dim=1)


def frame_rows(points: Tensor, links: Tensor, count: int, places: float = 1.0) -> Tensor:
    """What a product with frames (3, 4 c, n) takes to points: (k, 4 c) for points (k, 3) of links (k,)."""
    rows = points.new_zeros(len(points), count, 4)
    numbers = torch.arange(len(points))
    rows[numbers, links, :3] = points
    rows[numbers, links, 3] = places
    return rows.reshape(len(points), -1)


class SelfGap(nn.Module):
    """Whether an arm touches itself, exactly, by its spheres.

    For spheres of centres a and b and radii r and s, the difference of squares (a - b)^2 - (r + s)^2 is a
    product of six numbers of either, so that all pairs of two sets are one product of matrices.

    Of two sets with many pairs, balls that hold some spheres each are looked at first: where no ball of the
    one meets a ball of the other no sphere does, and the other configurations alone are looked at pair by
    pair.
    """

    def __init__(self, arm: GridArm) -> None:
        super().__init__()
        self.count, self.many = len(arm.touching), list[bool]()
        for number, sets in enumerate(arm.touching):
            self.many.append(len(sets[0]) * len(sets[1]) > _MANY_PAIRS)
            for side, spheres in zip(("first", "second"), sets, strict=True):
                self._hold(f"{side}_{number}", arm, spheres, arm.own_radii_m[spheres])
                if self.many[-1]:
                    self._hold(f"{side}_balls_{number}", arm, *_balls(arm, spheres))

    def forward(self, frames: Tensor) -> Tensor:
        """Above 0 for the arm free of itself, (n,), for frames (3, 4 (d + 1), n).

        It is the least difference of squares, m2, 1 at most; over those pairs alone that are not known to be
        apart by the balls that hold them.
        """
        least = frames.new_ones(frames.shape[2])
        for number, many in enumerate(self.many):
            if not many:
                least = torch.minimum(least, self._gaps(f"_{number}", frames))
                continue
            (close,) = torch.nonzero(self._gaps(f"_balls_{number}", frames) <= 0.0, as_tuple=True)
            found = self._gaps(f"_{number}", frames[:, :, close])
            least = torch.minimum(least, torch.ones_like(least).scatter(0, close, found))
        return least

    def _hold(
        self, name: str, arm: GridArm, spheres: NDArray[np.int64], radii_m: NDArray[np.float64]
    ) -> None:
        links = buffer(arm.links[spheres], torch.long)
        rows = frame_rows(buffer(arm.spheres_m[spheres, :3]), links, len(arm.axes) + 1)
        self.register_buffer(f"{name}_rows", rows, persistent=False)
        self.register_buffer(f"{name}_radii", buffer(radii_m)[:, None], persistent=False)

    def _gaps(self, kind: str, frames: Tensor) -> Tensor:
        """Least difference of squares of two sets, (n,) m2."""
        sides = []
        for side in ("first", "second"):
            centres, radii = (
                getattr(self, f"{side}{kind}_rows") @ frames,
                getattr(self, f"{side}{kind}_radii"),
            )
            rest = (centres * centres).sum(dim=0) - radii * radii
            one = torch.ones_like(rest)
            if side == "first":
                parts = torch.cat([-2.0 * centres, torch.stack([rest, one, -2.0 * radii * one])])
                sides.append(parts.permute(2, 1, 0))
            else:
                parts = torch.cat([centres, torch.stack([one, rest, radii * one])])
                sides.append(parts.permute(2, 0, 1))
        return (sides[0] @ sides[1]).amin(dim=(1, 2))


def _balls(arm: GridArm, spheres: NDArray[np.int64]) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
    """Balls that hold spheres (k,), each some of one link: numbers of those at their middles, radii in m."""
    middles, radii = [], []
    todo = [spheres[arm.links[spheres] == link] for link in np.unique(arm.links[spheres])]
    while todo:
        held = todo.pop()
        centres = arm.spheres_m[held, :3]
        if len(held) > _IN_A_BALL:
            order = held[np.argsort(centres[:, np.argmax(np.ptp(centres, axis=0))], kind="stable")]
            todo += [order[: len(held) // 2], order[len(held) // 2 :]]
            continue
        reach = np.linalg.norm(centres[:, None] - centres, axis=2) + arm.spheres_m[held, 3]
        middle = int(np.argmin(reach.max(axis=1)))
        middles.append(held[middle])
        radii.append(reach[middle].max() + _BALL_ROOM_M)
    return np.asarray(middles), np.asarray(radii)


def _cross(axes: Tensor) -> Tensor:
    """Matrices (d, 3, 3) of the cross product with each of (d, 3)."""
    x, y, z = axes.T
    zero = torch.zeros_like(x)
    rows = [[zero, -z, y], [z, zero, -x], [-y, x, zero]]
    return torch.stack([torch.stack(row, dim=1) for row in rows], dim=1)
