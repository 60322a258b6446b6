"""The pose that an arm waits in."""

import numpy as np
from numpy.typing import NDArray

from cspace.worlds.spatial.robot.arm import SerialArm


def ready_rad(arm: SerialArm) -> NDArray[np.float64]:
    """(d,) rad: the pose that an arm waits in; where nobody said, the middle of its joints' limits."""
    if arm.ready_rad is not None:
        return np.asarray(arm.ready_rad, dtype=np.float64)
    space = arm.space
    return np.where(space.periodic, 0.0, (np.asarray(space.lower) + np.asarray(space.upper)) / 2.0)
