"""The pose that an arm waits in."""

import numpy as np
from numpy.typing import NDArray

from cspace.worlds.spatial.robot.arm import SerialArm

# Of the arms that come with the project; others are ready in the middle of their joints' limits.
READY_RAD = {"panda": (0.0, -0.785, 0.0, -2.356, 0.0, 1.571, 0.785)}


def ready_rad(arm: SerialArm) -> NDArray[np.float64]:
    """(d,) rad: the pose that an arm waits in."""
    space = arm.space
    middle = np.where(space.periodic, 0.0, (np.asarray(space.lower) + np.asarray(space.upper)) / 2.0)
    return np.asarray(READY_RAD.get(arm.name, middle), dtype=np.float64)
