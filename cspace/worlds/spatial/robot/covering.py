"""Few spheres in place of many: groups of an arm's spheres, each held by one. Numpy alone."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from cspace.errors import ScenarioError
from cspace.worlds.spatial.robot.arm import SerialArm


@dataclass(frozen=True, slots=True, eq=False)
class Grouping:
    """Groups of an arm's S spheres, G of them, in the order of the parts.

    Attributes:
        links: (G,) the link of each group.
        spheres_m: (G, 4) centre in the link's frame and radius of a sphere that holds the group.
        groups: (S,) the group of each of the arm's spheres.
        weights: (G,) share of the volume of all spheres.
    """

    links: NDArray[np.int64]
    spheres_m: NDArray[np.float64]
    groups: NDArray[np.int64]
    weights: NDArray[np.float64]

    @property
    def members(self) -> NDArray[np.int64]:
        """(G, most) numbers of the spheres in each group, the first of them repeated behind the last."""
        held = [np.flatnonzero(self.groups == number) for number in range(len(self.links))]
        most = max(len(one) for one in held)
        return np.stack([np.append(one, np.full(most - len(one), one[0])) for one in held])


def grouped(arm: SerialArm, count: int) -> Grouping:
    """The spheres of an arm in groups of one part each: the largest is halved until there are enough.

    Args:
        arm: with spheres.
        count: of groups; no fewer than parts, no more than spheres.

    Raises:
        ScenarioError: no such number of groups is possible.
    """
    if not len(arm.parts) <= count <= arm.sphere_count or not arm.parts:
        raise ScenarioError(
            "the arm's spheres cannot be grouped so",
            expected=f"{len(arm.parts)} to {arm.sphere_count} groups",
            got=str(count),
        )
    spheres, ends = arm.spheres_m(), np.cumsum([len(part.spheres_m) for part in arm.parts])
    members = np.split(np.arange(len(spheres)), ends[:-1])
    held = [_holding(spheres[one]) for one in members]
    while len(members) < count:
        sizes = [sphere[3] if len(one) > 1 else -1.0 for one, sphere in zip(members, held, strict=True)]
        at = int(np.argmax(sizes))
        halves = _halves(spheres, members[at])
        members[at : at + 1] = halves
        held[at : at + 1] = [_holding(spheres[one]) for one in halves]
    groups = np.empty(len(spheres), dtype=np.int64)
    for number, one in enumerate(members):
        groups[one] = number
    volumes = np.bincount(groups, spheres[:, 3] ** 3)
    links = arm.sphere_links()[[one[0] for one in members]]
    return Grouping(links, np.stack(held), groups, volumes / volumes.sum())


def _holding(spheres: NDArray[np.float64]) -> NDArray[np.float64]:
    """A sphere (4,) round spheres (n, 4): from the middle of their box, moved while it shrinks."""
    centres, radii = spheres[:, :3], spheres[:, 3]
    middle = ((centres - radii[:, None]).min(axis=0) + (centres + radii[:, None]).max(axis=0)) / 2.0
    # Towards what sticks out the most, by less and less (Badoiu and Clarkson's core sets).
    for turn in range(1, 200):
        reach = np.linalg.norm(centres - middle, axis=1) + radii
        middle = middle + (centres[int(np.argmax(reach))] - middle) / (turn + 1.0) ** 1.5
    return np.append(middle, (np.linalg.norm(centres - middle, axis=1) + radii).max())


def _halves(spheres: NDArray[np.float64], members: NDArray[np.int64]) -> list[NDArray[np.int64]]:
    centres = spheres[members, :3]
    spread = centres - centres.mean(axis=0)
    along = spread @ np.linalg.svd(spread, full_matrices=False)[2][0]
    order = members[np.argsort(along, kind="stable")]
    return [np.sort(order[: len(order) // 2]), np.sort(order[len(order) // 2 :])]
