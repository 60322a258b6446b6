"""Small path data for the tests of path models: one kind of path through an empty space."""

import numpy as np
import torch

from cspace.worlds.planar.arm import TWO_LINK
from training.models.paths import PathSamples

LATENT = 3
POINTS = 17


def straight_paths(count: int = 40, seed: int = 0) -> np.ndarray:
    """Straight ways between random ends, (count, POINTS, 2) rad."""
    rng = np.random.default_rng(seed)
    space = TWO_LINK.space
    ends = space.sample_uniform(rng, 2 * count).reshape(2, count, 2)
    share = np.linspace(0.0, 1.0, POINTS)[:, None]
    ways = ends[0][:, None] + share * space.difference(ends[0], ends[1])[:, None]
    return space.wrap(ways).astype(np.float32)


def samples(count: int = 40, scenarios: int = 4) -> PathSamples:
    """Straight paths in scenarios without an obstacle."""
    ids, latents = torch.arange(count) % scenarios, torch.zeros(scenarios, LATENT)
    return PathSamples(torch.tensor(straight_paths(count)), ids, latents, latents)


def generator(seed: int = 0) -> torch.Generator:
    """A random generator."""
    return torch.Generator().manual_seed(seed)
