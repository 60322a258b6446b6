"""Which parts of an arm can touch each other, from configurations drawn at random."""

from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np

from cspace.worlds.spatial.arm import SerialArm
from cspace.worlds.spatial.kinematics import arm_arrays, self_distance_batch

Pairs = frozenset[frozenset[str]]
# As MoveIt's setup assistant counts a pair that always collides.
ALWAYS_SHARE = 0.95
_DRAWN = 4000


@dataclass(frozen=True, slots=True)
class Touching:
    """How often the spheres of two parts overlap.

    Args:
        pair: their names.
        share: of configurations.
        kept: whether they are held apart.
    """

    pair: tuple[str, str]
    share: float
    kept: bool


def touching_pairs(
    arm: SerialArm, neighbours: Pairs, disabled: Pairs, kept: Pairs, rng: np.random.Generator
) -> tuple[Touching, ...]:
    """All pairs of parts of different links that are looked at, and which of them can touch.

    Neighbours, disabled pairs, those that never touch, and those that nearly always do are not held apart.

    Args:
        arm: without such pairs.
        neighbours: parts that a joint connects.
        disabled: parts that need no check.
        kept: parts that are held apart whatever the others say.
        rng: draws configurations.
    """
    space = arm.space
    drawn = rng.uniform(space.lower, space.upper, (_DRAWN, arm.dim))
    found = []
    for first, second in combinations(arm.parts, 2):
        pair = frozenset((first.name, second.name))
        left_out = pair not in kept and (pair in disabled or pair in neighbours)
        if first.link == second.link or left_out:
            continue
        names = (first.name, second.name)
        distances = self_distance_batch(drawn, arm_arrays(replace(arm, touching=(names,))))
        share = float(np.mean(distances < 0.0))
        found.append(Touching(names, share, pair in kept or 0.0 < share < ALWAYS_SHARE))
    return tuple(found)
