"""A batch of learned samples, and the port to whatever gives one for a picture."""

import secrets
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

MAX_SAMPLES = 20_000
"""Of one request."""


@dataclass(frozen=True, slots=True)
class SourceTiming:
    """Where a source's own time went, in s; what a round trip takes beyond the total is transport.

    Args:
        decode_s: reading the picture; 0 for one that was known.
        encode_s: the picture's latent; 0 for one that was known.
        generate_s: drawing, and scoring where that is asked for.
        total_s: all of it, what the other three leave out among it.
    """

    decode_s: float
    encode_s: float
    generate_s: float
    total_s: float


@dataclass(frozen=True, slots=True, eq=False)
class SampleBatch:
    """Learned samples for one picture, with the model they come from.

    Args:
        samples: (n, d) float32 rad, each in [-pi, pi).
        model_name: of the model that answered; ``pretrained`` for the one that ships with the server.
        model_version: its number in the registry.
        digest: of its bundle.
        seed: that was used, whether asked for or drawn.
        shortfall: how many fewer samples came than were asked for.
        round_trip_s: from the request to the checked answer, further attempts included.
        novelty: how unlike the model's training scenarios the picture is, 0 to 1; None where it is not told.
        fallback: whether another source answered because the server stayed away.
        timing: where the source's own time went; None where it is not told.
    """

    samples: NDArray[np.float32]
    model_name: str
    model_version: int
    digest: str
    seed: int
    shortfall: int
    round_trip_s: float
    fallback: bool = False
    novelty: float | None = None
    timing: SourceTiming | None = None


class SampleSource(Protocol):
    """Draws configurations for a picture."""

    def sample(
        self,
        image_png: bytes,
        n: int,
        *,
        model: str | None = None,
        seed: int | None = None,
        epsilon_sigma: Sequence[float] = (),
        start: Sequence[float] | None = None,
        goal: Sequence[float] | None = None,
        min_confidence: float | None = None,
    ) -> SampleBatch:
        """One batch of at most ``n`` samples.

        Args:
            image_png: the scenario's picture as a PNG file.
            n: how many, 1 to ``MAX_SAMPLES``.
            model: ``name``, ``name@alias``, ``name/version`` or ``pretrained``; None for the default.
            seed: unsigned 64 bit; None for one that the source draws.
            epsilon_sigma: what the encoder's standard deviation is raised by, in equal shares; empty for the
                default.
            start: d angles in rad, for path models only.
            goal: likewise.
            min_confidence: what the model's validity head has to score; None for the model's own threshold,
                0 for the samples as they come.

        Raises:
            SamplerUnavailableError: the source does not answer or has no model ready.
            SamplerError: it refused the request; of this kind, SamplerAnswerError: its answer can not be
                used.
        """
        ...


def drawn_seed(seed: int | None) -> int:
    """The seed, or one that is drawn here, so that a request that is sent again is the same request."""
    return secrets.randbits(64) if seed is None else seed
