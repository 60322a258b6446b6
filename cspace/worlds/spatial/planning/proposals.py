"""Configurations of a scene that a head learns from: anywhere, near contact, about ends, along ways.

Ways that are free teach a head that whatever looks like a way is free, and a planner that believes it goes
where it is wrong. So there are mistaken ways as well, of a planner that does not know of some obstacles.
"""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from cspace.workshop import Proposals, near_contact
from cspace.worlds.spatial.obstacles.layout import GoalRegion
from cspace.worlds.spatial.obstacles.shapes import Obstacles
from cspace.worlds.spatial.planning.collision import CollisionChecker
from cspace.worlds.spatial.planning.problems import Ends
from cspace.worlds.spatial.planning.ways import WayLimits, find_way

# Of each origin but the first, which gets the rest.
SHARES = (0.2, 0.25, 0.15, 0.2)
NEAR_M, NEAR_SIGMA_RAD = 0.06, 0.05
# About an end are half of them near by, half farther away; beside a way they are near.
END_SIGMAS_RAD, WAY_SIGMA_RAD = (0.12, 0.3), 0.1
GOALS = 4
# Of the obstacles, that a mistaken planner knows; its ways are looked at where they are.
KNOWN_SHARES, MISTAKEN_SIGMA_RAD = (0.0, 0.4, 0.8), 0.03
# One short way to each goal is enough to be beside.
_LIMITS = WayLimits(states=1500, tries=1, shortcuts=40, polish=0, step_rad=0.2)


def draw_proposals(
    checker: CollisionChecker,
    regions: Sequence[GoalRegion],
    start: NDArray[np.float64] | None,
    rng: np.random.Generator,
    count: int,
) -> Proposals:
    """So many configurations, uniform ones first.

    Args:
        checker: of the scene.
        regions: that hands reach into.
        start: (d,) rad, where the arm waits; None where that is not known.
        rng: of all draws.
        count: how many.
    """
    space = checker.space
    counts = [int(share * count) for share in SHARES]
    anywhere = space.sample_uniform(rng, count - sum(counts))
    near = near_contact(checker, rng, counts[0], NEAR_M, NEAR_SIGMA_RAD)
    ends = _ends(checker, regions, start, rng)
    sigmas = np.asarray(END_SIGMAS_RAD)[rng.integers(len(END_SIGMAS_RAD), size=counts[1])]
    about = _about(checker, ends, sigmas, rng)
    beside = _about(checker, _along(checker, ends, rng), np.full(counts[2], WAY_SIGMA_RAD), rng)
    mistaken = _about(checker, _mistaken(checker, ends, rng), np.full(counts[3], MISTAKEN_SIGMA_RAD), rng)
    rows = (anywhere, near, about, beside, mistaken)
    origins = np.repeat(np.arange(len(rows), dtype=np.uint8), [len(part) for part in rows])
    return Proposals(np.concatenate(rows), origins)


def _ends(
    checker: CollisionChecker,
    regions: Sequence[GoalRegion],
    start: NDArray[np.float64] | None,
    rng: np.random.Generator,
) -> NDArray[np.float64]:
    """Where the arm waits, and goals, (k, d) rad, at least one."""
    drawn = Ends(checker, regions, rng)
    found = [drawn.home() if start is None else start, *(drawn.reaching() for _ in range(GOALS))]
    known = [one for one in found if one is not None]
    return np.stack(known) if known else checker.space.sample_uniform(rng, 1)


def _along(
    checker: CollisionChecker, ends: NDArray[np.float64], rng: np.random.Generator
) -> NDArray[np.float64]:
    """States of ways from the first end to the others, (n, d) rad; the ends where there is no way."""
    ways = [find_way(checker, ends[0], goal, rng, _LIMITS) for goal in ends[1:]]
    return np.concatenate([ends, *(way for way in ways if way is not None)])


def _mistaken(
    checker: CollisionChecker, ends: NDArray[np.float64], rng: np.random.Generator
) -> NDArray[np.float64]:
    """States of ways that are free of some of the obstacles alone, (n, d) rad, evenly spaced."""
    found = [ends]
    for share in KNOWN_SHARES:
        known = CollisionChecker(checker.arm, _some(checker.obstacles, share, rng))
        first, last = ends[rng.integers(len(ends))], ends[rng.integers(len(ends))]
        way = find_way(known, first, last, rng, _LIMITS)
        found += [] if way is None else [way]
    return np.concatenate(found)


def _some(obstacles: Obstacles, share: float, rng: np.random.Generator) -> Obstacles:
    """Each obstacle with such a probability."""
    boxes = tuple(one for one in obstacles.boxes if rng.random() < share)
    cylinders = tuple(one for one in obstacles.cylinders if rng.random() < share)
    return Obstacles(boxes, cylinders)


def _about(
    checker: CollisionChecker,
    centres: NDArray[np.float64],
    sigmas: NDArray[np.float64],
    rng: np.random.Generator,
) -> NDArray[np.float64]:
    """A configuration near one of (k, d) rad for each sigma."""
    rows = centres[rng.integers(len(centres), size=len(sigmas))]
    return checker.space.bound(rows + rng.normal(size=rows.shape) * sigmas[:, None])
