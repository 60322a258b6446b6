"""The pose that an arm waits in."""

import numpy as np
from numpy.typing import NDArray

from cspace.worlds.spatial.robot.arm import SerialArm

# Of the arm whose file came before files told it.
READY_RAD = {"panda": (0.0, -0.785, 0.0, -2.356, 0.0, 1.571, 0.785)}


def ready_rad(arm: SerialArm) -> NDArray[np.float64]:
    """(d,) rad: the pose that an arm waits in; where nobody said, the middle of its joints' limits."""
    if arm.ready_rad is not None:
        return np.asarray(arm.ready_rad, dtype=np.float64)
    space = arm.space
    middle = np.where(space.periodic, 0.0, (np.asarray(space.lower) + np.asarray(space.upper)) / 2.0)
    return np.asarray(READY_RAD.get(arm.name, middle), dtype=np.float64)
