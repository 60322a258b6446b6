"""Arms by chance, so that what is learned with them serves an arm that nobody has seen."""

import numpy as np
from numpy.typing import NDArray

from cspace.worlds.spatial.arm import Joint, Part, SerialArm
from cspace.worlds.spatial.poses import Frame

_AXES = {"y": (0.0, 1.0, 0.0), "z": (0.0, 0.0, 1.0)}
# Axes of joints from the base on, as arms have them that are sold.
_PATTERNS = ("zyzyzyz", "zyyyzy", "zyyzyz")
# Links that are so many joints apart can touch.
_APART = 3
_HOLDS = 0.3

_Sphere = tuple[float, float, float, float]


def random_arm(seed: int) -> SerialArm:
    """An arm of six or seven joints: rods of spheres, with fingers that may hold something."""
    rng = np.random.default_rng(seed)
    pattern = _PATTERNS[int(rng.integers(len(_PATTERNS)))]
    size = rng.uniform(0.7, 1.2)
    steps = _steps(rng, pattern, size)
    joints, parts = [], []
    thick = rng.uniform(0.045, 0.09) * size
    for number, axis in enumerate(pattern, 1):
        bend = 2.8 if axis == "z" else rng.uniform(1.8, 2.6)
        joints.append(Joint(f"joint{number}", _frame(steps[number - 1]), _AXES[axis], (-bend, bend)))
        thick *= rng.uniform(0.85, 1.0)
        spheres = _rod(steps[number], thick)
        if number == len(pattern):
            spheres += _hand(rng, steps[-1], size)
        parts.append(Part(f"link{number}", number, tuple(spheres)))
    pairs = tuple((a.name, b.name) for i, a in enumerate(parts) for b in parts[i + _APART :])
    bent = [number for number, axis in enumerate(pattern) if axis == "y"]
    ready = dict(zip(bent, (0.2, 1.2, 0.8), strict=False))
    waits = tuple(ready.get(number, 0.0) for number in range(len(pattern)))
    return SerialArm(f"random{seed}", tuple(joints), tuple(parts), pairs, _frame(steps[-1]), waits)


def _frame(place_m: NDArray[np.float64]) -> Frame:
    x, y, z = (float(one) for one in place_m)
    return Frame((x, y, z))


def _steps(rng: np.random.Generator, pattern: str, size: float) -> list[NDArray[np.float64]]:
    """From each frame to the next one, m, and to the tool: long behind shoulder and elbow."""
    bends, found = 0, [np.array([0.0, 0.0, rng.uniform(0.1, 0.4) * size])]
    for axis in pattern[1:]:
        is_long = axis == "y" and 0 < bends < 3
        along = rng.uniform(0.3, 0.45) if is_long else rng.uniform(0.06, 0.14)
        bends += axis == "y"
        aside = rng.uniform(-0.1, 0.1, 2) * (rng.random(2) < 0.5)
        found.append(np.array([aside[0], aside[1], along]) * size)
    return [*found, np.array([0.0, 0.0, rng.uniform(0.06, 0.22) * size])]


def _rod(step: NDArray[np.float64], radius: float) -> list[_Sphere]:
    count = max(6, int(np.ceil(np.linalg.norm(step) / (0.5 * radius))))
    x, y, z = (float(one) for one in step)
    return [
        (share * x, share * y, share * z, float(radius)) for share in np.linspace(0.0, 1.0, count).tolist()
    ]


def _hand(rng: np.random.Generator, tip: NDArray[np.float64], size: float) -> list[_Sphere]:
    """Two fingers at the tip of the last link, and what joins them."""
    wide, radius = rng.uniform(0.03, 0.1) * size, rng.uniform(0.01, 0.025)
    back, end = rng.uniform(0.04, 0.12) * size, float(tip[2])
    found = [
        (0.0, side * wide, end - share * back, radius)
        for side in (-1, 1)
        for share in np.linspace(0.0, 1.0, 5).tolist()
    ]
    found += [(0.0, y, end - back, 1.5 * radius) for y in np.linspace(-wide, wide, 7).tolist()]
    if rng.random() < _HOLDS:
        half, radius = rng.uniform(0.05, 0.25) / 2.0, rng.uniform(0.02, 0.05)
        found += [(0.0, y, end, radius) for y in np.linspace(-half, half, 8).tolist()]
    return found
