"""What a head says, computed straight on: what is quicker is held to it."""

import numpy as np
import torch
from scipy.ndimage import map_coordinates
from torch import Tensor
from torch.nn import functional

from cspace.world import GridArm
from cspace.worlds.spatial.arm import SerialArm
from training.models.grid_head import GridHead
from training.models.kinematics import buffer


def arm_points(body: SerialArm, arm: GridArm, rows: Tensor) -> tuple[Tensor, Tensor]:
    """Configurations (n, d) rad to the spheres' centres (n, 3, S) m and those of their groups (n, 3, G)."""
    centres = np.pad(arm.group_spheres_m[:, :3], ((0, 0), (0, 1)), constant_values=1.0)
    frames = body.link_frames(rows.numpy())[:, arm.group_links]
    groups = np.einsum("ngij,gj->nig", frames[..., :3, :], centres)
    spheres = body.sphere_centres_m(rows.numpy()).swapaxes(1, 2)
    return torch.from_numpy(spheres).float(), torch.from_numpy(groups).float()


def plain_answers(
    head: GridHead, body: SerialArm, arm: GridArm, picture: Tensor, rows: Tensor
) -> tuple[Tensor, Tensor]:
    """P(free of obstacles) and unseen share, (n,), for one picture (1, 2, X, Y, Z) and (n, d) rad."""
    spheres, groups = arm_points(body, arm, rows)
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
    places = grid_places(arm, spheres, arm.voxel_m)
    near = interpolated(picture[:, 0], places)[..., 0] * 255.0 * arm.distance_step_m
    codes = nearest(picture[0, 1], places)
    radii = buffer(arm.spheres_m[arm.links > 0, 3])
    return near - radii, (codes > 0.5 / 255.0).float()


def at_groups(head: GridHead, arm: GridArm, picture: Tensor, spheres: Tensor, groups: Tensor) -> Tensor:
    """All but margins, sight and names, (n, G, k)."""
    x, y, z = (count // head.stride for count in head.counts)
    coarse = grid_places(arm, groups, head.stride * arm.voxel_m)
    features = interpolated(head.encode(picture).reshape(x, y, z, -1).permute(3, 0, 1, 2), coarse)
    inside = (coarse - coarse.floor() - 0.5).transpose(1, 2)
    code = nearest(picture[0, 1], grid_places(arm, groups, arm.voxel_m)).unsqueeze(-1)
    free, out = (code < 0.5 / 255.0).float(), (code > 254.5 / 255.0).float()
    unread = ((code - arm.no_reading / 255.0).abs() < 0.5 / 255.0).float()
    hidden = 1.0 - free - out - unread
    members, centres = buffer(arm.members, torch.long), buffer(arm.group_spheres_m[:, :3])
    gaps = (buffer(arm.spheres_m[:, :3])[members] - centres[:, None]).norm(dim=2)
    farthest = torch.gather(members, 1, gaps.argmax(dim=1, keepdim=True))[:, 0]
    along = (spheres[:, :, farthest] - groups).transpose(1, 2) / 0.1
    places = groups.transpose(1, 2)
    return torch.cat([features, places, inside, along, free, unread, out, hidden, hidden * code], dim=2)


def grid_places(arm: GridArm, points: Tensor, voxel_m: float) -> Tensor:
    """Points (n, 3, k) m, in voxels from the grid's lowest corner."""
    return (points - buffer(arm.low_m)[:, None]) / voxel_m


def interpolated(table: Tensor, places: Tensor) -> Tensor:
    """Trilinear between voxels (C, X, Y, Z) at places (n, 3, k): (n, k, C)."""
    middles = places.transpose(0, 1).numpy() - 0.5
    found = [map_coordinates(one.numpy(), middles, order=1, mode="nearest") for one in table]
    return torch.from_numpy(np.stack(found, axis=-1))


def nearest(table: Tensor, places: Tensor) -> Tensor:
    """Values (n, k) of the voxels (X, Y, Z) that places (n, 3, k) lie in, or of the nearest ones."""
    x, y, z = (places[:, axis].long().clamp(0, count - 1) for axis, count in enumerate(table.shape))
    return table[x, y, z]


def scales(margins: Tensor) -> Tensor:
    """(n, G) m to (n, G, 3)."""
    return torch.stack(
        [(margins / 0.1).clamp(-1.0, 1.2), torch.tanh(margins / 0.01), torch.tanh(margins / 0.03)], dim=2
    )
