"""What networks see of angles: cosines and sines, which know nothing of turns."""

from itertools import combinations

import torch
from torch import Tensor

HARMONICS = 3


def harmonics(angles: Tensor) -> Tensor:
    """Cos and sin of k theta for k up to 3: (..., d) to (..., 6 d)."""
    multiples = torch.cat([angles * k for k in range(1, HARMONICS + 1)], dim=-1)
    return torch.cat([torch.cos(multiples), torch.sin(multiples)], dim=-1)


def torus_features(angles: Tensor) -> Tensor:
    """Harmonics of every joint, and of the sum and difference of every pair.

    Shapes: (..., d) to (..., 6 d + 2 d (d - 1)).
    """
    pairs = list(combinations(range(angles.shape[-1]), 2))
    if not pairs:
        return harmonics(angles)
    first = torch.stack([angles[..., i] for i, _ in pairs], dim=-1)
    second = torch.stack([angles[..., j] for _, j in pairs], dim=-1)
    mixed = torch.cat([first + second, first - second], dim=-1)
    return torch.cat([harmonics(angles), torch.cos(mixed), torch.sin(mixed)], dim=-1)


def on_torus(embedded: Tensor) -> Tensor:
    """Angles of an embedding: (m, 2 d) cosines, then sines, of any length above 0, to (m, d) rad."""
    cosines, sines = embedded.chunk(2, dim=-1)
    return torch.atan2(sines, cosines)
