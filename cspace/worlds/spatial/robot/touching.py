"""Which spheres of an arm must not touch which, in as few sets as say so. Numpy alone."""

import numpy as np
from numpy.typing import NDArray

from cspace.worlds.spatial.robot.arm import SerialArm

Sets = tuple[tuple[NDArray[np.int64], NDArray[np.int64]], ...]


def touching_sets(arm: SerialArm) -> Sets:
    """Pairs of sets of spheres, each of numbers (a,) and (b,), all of whose pairs can touch.

    Parts that can touch the same others are in one set, so that each pair of spheres is in one pair of sets.
    """
    ends = np.cumsum([len(part.spheres_m) for part in arm.parts])
    own = {
        part.name: np.arange(end - len(part.spheres_m), end)
        for part, end in zip(arm.parts, ends, strict=True)
    }
    partners = {name: tuple(sorted(b for a, b in arm.touching if a == name)) for name in own}
    alike: dict[tuple[str, ...], list[str]] = {}
    for name, others in partners.items():
        if others:
            alike.setdefault(others, []).append(name)
    return tuple(
        (np.concatenate([own[one] for one in names]), np.concatenate([own[one] for one in others]))
        for others, names in alike.items()
    )
