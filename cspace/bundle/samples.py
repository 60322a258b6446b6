"""What goes through a bundle: a picture's encoding, a picture for many requests, the samples of one."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from cspace.errors import BundleError
from cspace.space import JointSpace


@dataclass(frozen=True, slots=True)
class Encoding:
    """The encoder's view of one picture.

    Args:
        mu: float32 (L,).
        sigma: float32 (L,), not negative.
    """

    mu: NDArray[np.float32]
    sigma: NDArray[np.float32]


@dataclass(frozen=True, slots=True, eq=False)
class Picture:
    """A picture that a bundle has encoded; what it costs is paid once. Make one with :meth:`Bundle.prepare`.

    Args:
        digest: of the bundle.
        pixels: float32 (1, 3, P, P), as the graphs take it.
        encoding: the encoder's view of it.
        novelty: how unlike the training scenarios it is, 0 to 1; None for a bundle that does not tell.
        map: float32, what the bundle's map graph makes of it; None for a bundle without.
    """

    digest: str
    pixels: NDArray[np.float32]
    encoding: Encoding
    novelty: float | None = None
    map: NDArray[np.float32] | None = None

    @property
    def size_bytes(self) -> int:
        """Of what it holds, nearly."""
        return self.pixels.nbytes + (0 if self.map is None else self.map.nbytes)


@dataclass(frozen=True, slots=True, eq=False)
class Drawn:
    """What a sampler draws.

    Args:
        samples: float32 (n', d) rad.
        told: float32 (n',), the validity head's confidence, or (n', 2) with the unseen share beside it; None
            where it was not asked.
        acceptance: share of what was drawn that reached the confidence asked for.
        ways: int64 (n',), see :class:`SampleSet`.
    """

    samples: NDArray[np.float32]
    told: NDArray[np.float32] | None = None
    acceptance: float = 1.0
    ways: NDArray[np.int64] | None = None


@dataclass(frozen=True, slots=True)
class SampleSet:
    """Configurations for one picture.

    Args:
        samples: float32 (n', d) rad, circles in [-pi, pi), others within their limits, as real numbers.
        confidence: float32 (n',), None without a validity head.
        shortfall: how many of those asked for are missing, n - n'.
        acceptance: share of what was drawn that reached the confidence asked for; 1 where none was.
        encode_ms: time in the encoder; 0 for a picture that was prepared.
        generate_ms: time from the latents to the samples, the validity head included.
        unseen: float32 (n',), share of the robot where no picture shows what is there; None where that is not
            told.
        ways: int64 (n',), the way that each sample lies along, 0 for the one that is doubted least; None for
            samples that were not drawn along ways.
    """

    samples: NDArray[np.float32]
    confidence: NDArray[np.float32] | None
    shortfall: int
    acceptance: float
    encode_ms: float
    generate_ms: float
    unseen: NDArray[np.float32] | None = None
    ways: NDArray[np.int64] | None = None


def require_inside(samples: NDArray[np.float32], space: JointSpace) -> None:
    """Raise where a configuration (n, d) is outside the joint space, which no sampler's may be.

    Raises:
        BundleError: one is.
    """
    if not space.is_torus and not np.all(space.contains(samples)):
        raise BundleError(
            "a sample lies outside the limits of the robot's joints",
            expected=f"joints from {space.lower} to {space.upper} rad",
            got=str(samples[~space.contains(samples)][0].tolist()),
        )
