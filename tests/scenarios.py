"""Scenarios of the planar world."""

from collections.abc import Sequence

from cspace.simulator import Split
from cspace.worlds.planar.arm import TWO_LINK, PlanarArm
from cspace.worlds.planar.simulator import PlanarSimulator
from cspace.worlds.planar.world import PlanarWorld, Scenario


def random_scenarios(split: Split, seed: int, count: int, robot: PlanarArm = TWO_LINK) -> Sequence[Scenario]:
    """The first ``count`` of a split under a seed, of the usual family."""
    return PlanarSimulator(PlanarWorld(robot)).scenes(split, seed, count)
