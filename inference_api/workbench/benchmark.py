"""MotionBenchMaker's problems for the page: those that ship, and those that somebody has fetched."""

from dataclasses import replace
from pathlib import Path
from typing import Any, cast

from cspace.errors import InputError
from cspace.simulator import Asked, Problem, Split
from cspace.world import World
from cspace.worlds import partly_seen

SOURCE = "MotionBenchMaker"
# One hides most, which is what the view is for; the page asks for more.
_PICTURES = 1


def benchmark_families(world: World) -> tuple[str, ...]:
    """Names of its sets; none for other robots than the one that they were made for."""
    return partly_seen(world).sources.get(SOURCE, ())


def benchmark_problem(world: World, family: str, at: int, folder: Path | None) -> Problem:
    """The problem at a place of a set, seen by a camera: those of validation first, then those of the test.

    Args:
        world: of the robot that the sets were made for.
        family: one of :func:`benchmark_families`.
        at: from 0 on; beyond the last it begins anew.
        folder: that ``python -m training.motionbench fetch`` filled; None for those that ship.

    Raises:
        InputError: an end of the problem touches something, as the robot's spheres have it, or lies outside
            the limits of the world's robot.
        DatasetError: the folder holds no such problems.
    """
    seen = partly_seen(world)
    splits = (Split.VALIDATION,) if folder is None else (Split.VALIDATION, Split.TEST)
    counts = [seen.count(family, split) or 0 for split in splits]
    at %= sum(counts)
    split, index = (splits[0], at) if at < counts[0] else (splits[-1], at - counts[0])
    found = seen.problem(Asked(split, folder=folder), family, index, _PICTURES)
    if found is None:
        raise InputError(
            f"the arm's spheres touch something at an end of problem {at} of {family}",
            expected="a problem whose ends are free",
            remedy="take another seed",
        )
    if not world.space.contains([found.start, found.goal]).all():
        raise InputError(
            f"an end of problem {at} of {family} needs the benchmark's limits",
            expected="a problem within the limits of the model's arm",
            remedy="take another seed",
        )
    # The problem is looked at and solved as any other, with the limits that the model is served with.
    return replace(found, scenario=replace(cast("Any", found.scenario), world=world))
