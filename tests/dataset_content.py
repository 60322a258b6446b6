"""What a small data set holds, for every test that writes one."""

from typing import Any

import numpy as np

from cspace.worlds.planar.arm import TWO_LINK, PlanarArm
from cspace.worlds.planar.camera import Camera
from cspace.worlds.planar.world import PlanarWorld

CAMERA = Camera(pixels=16)
SCENARIOS, EXTRAS = 3, 2


def content(robot: PlanarArm = TWO_LINK, seed: int = 0, **changes: Any) -> dict[str, Any]:
    """Arguments of ``write_dataset``: three scenarios, one without free, one without colliding ones."""
    rng, draw = np.random.default_rng(seed), robot.space.sample_uniform
    values = {
        "world": PlanarWorld(robot, CAMERA),
        "images": rng.integers(0, 256, (SCENARIOS, 16, 16, 3), dtype=np.uint8),
        "free": [draw(rng, count) for count in (4, 0, 6)],
        "collision": [draw(rng, count) for count in (1, 2, 0)],
        "paths": [(2, draw(rng, 5)), (0, draw(rng, 2))],
        "scenes": {"discs": rng.uniform(0.5, 4, (SCENARIOS, 3, 3))},
        "extra_images": rng.integers(0, 256, (EXTRAS, 16, 16, 3), dtype=np.uint8),
        "generator": {"seed": 7},
    }
    return values | changes
