"""What is asked of a sampler, and the batch that it answers."""

import re
import secrets
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol, TypedDict

import numpy as np
from numpy.typing import ArrayLike, NDArray

from cspace_client.errors import SamplerError
from cspace_client.joint_space import JointSpace
from cspace_client.model import PictureWarning
from cspace_client.pictures import Picture

MAX_SAMPLES = 20_000
"""Of one request."""

PLAIN = (0.0,)
"""The schedule that leaves the encoder's standard deviation as it is."""


class Wanted(Protocol):
    """What is asked of a sampler; :class:`SampleQuery`, or any value with the same members."""

    @property
    def n(self) -> int:
        """How many samples."""

    @property
    def seed(self) -> int:
        """Unsigned 64 bit."""

    @property
    def epsilon_sigma(self) -> tuple[float, ...]:
        """What the latent's standard deviation is raised by, in equal shares of the samples."""

    @property
    def start(self) -> tuple[float, ...] | None:
        """(d,) rad, for path models."""

    @property
    def goal(self) -> tuple[float, ...] | None:
        """As ``start``."""

    @property
    def min_confidence(self) -> float | None:
        """What the validity head has to score; None for the model's own threshold."""

    @property
    def robot(self) -> str | None:
        """Whose configurations are wanted."""


class QueryOptions(TypedDict, total=False):
    """What a call that asks for samples may leave out, as :class:`SampleQuery` has it."""

    epsilon_sigma: Sequence[float]
    start: ArrayLike | None
    goal: ArrayLike | None
    min_confidence: float | None
    robot: str | None


@dataclass(frozen=True, slots=True)
class SampleQuery:
    """A request for samples; the server judges its ranges.

    Args:
        n: how many, 1 to ``MAX_SAMPLES``.
        seed: unsigned 64 bit.
        epsilon_sigma: the latent's standard deviation is raised by each value, 0 to 10; equal shares of the
            samples in this order, the remainder to the first.
        start: (d,) rad, for path models and only for them.
        goal: as ``start``.
        min_confidence: what the validity head has to score, 0 to 1; None for the model's own threshold,
            0 for all samples as they come.
        robot: whose configurations are wanted, the digest that ``GET /models`` tells; None for any.
    """

    n: int
    seed: int
    epsilon_sigma: tuple[float, ...] = PLAIN
    start: tuple[float, ...] | None = None
    goal: tuple[float, ...] | None = None
    min_confidence: float | None = None
    robot: str | None = None

    @classmethod
    def of(
        cls,
        n: int,
        seed: int | None,
        epsilon_sigma: Sequence[float] = PLAIN,
        start: ArrayLike | None = None,
        goal: ArrayLike | None = None,
        min_confidence: float | None = None,
        robot: str | None = None,
    ) -> "SampleQuery":
        """The query of numbers and arrays of any kind; without a seed one is drawn.

        Raises:
            SamplerError: a value is of another kind.
        """
        return cls(
            _whole("n", n),
            drawn_seed() if seed is None else _whole("seed", seed),
            configuration("epsilon_sigma", epsilon_sigma),
            None if start is None else configuration("start", start),
            None if goal is None else configuration("goal", goal),
            None if min_confidence is None else configuration("min_confidence", [min_confidence])[0],
            robot,
        )


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
        samples: (n, d) float32 rad, circles in [-pi, pi), other joints within the limits that are told.
        model_name: of the model that answered; ``pretrained`` for the one that ships with the server.
        model_version: its number in the registry.
        digest: of its bundle.
        seed: that was used, whether asked for or drawn.
        shortfall: how many fewer samples came than were asked for.
        round_trip_s: from the request to the checked answer, further attempts included.
        novelty: how unlike the model's training scenarios the picture is, 0 to 1; None where it is not told.
        fallback: whether another source answered because the server stayed away.
        timing: where the source's own time went; None where it is not told.
        acceptance: share of what was drawn that reached the confidence asked for; None where it is not told.
        robot: whose configurations they are, the SHA-256 that ``GET /models`` tells beside the robot itself;
            None where it is not told.
        alias_confirmed: whether the server is sure of what the model's alias stands for; None where it is not
            told.
        confidence: (n,) float32, what the model's validity head scores each sample, 0 to 1; None for a model
            without one, for samples that were not filtered by it, and over HTTP, whose ``.npy`` has no room
            for it.
        space: the joint space; None where it is not told.
        warnings: what is wrong, or may be, with the pictures.
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
    acceptance: float | None = None
    robot: str | None = None
    alias_confirmed: bool | None = None
    confidence: NDArray[np.float32] | None = None
    space: JointSpace | None = None
    warnings: tuple[PictureWarning, ...] = ()


class Source(Protocol):
    """Whatever answers with samples: a client, or what stands in for a server."""

    def answer(self, picture: Picture, query: Wanted, model: str | None = None) -> SampleBatch:
        """At most ``query.n`` samples, of the same picture and seed the same.

        Raises:
            SamplerError: it has no answer.
        """


def is_digest(value: object) -> bool:
    """Whether a value is a SHA-256 in hexadecimal, in small letters."""
    return isinstance(value, str) and re.fullmatch("[0-9a-f]{64}", value, re.ASCII) is not None


def drawn_seed() -> int:
    """A seed; with it a request that is sent again is the same request."""
    return secrets.randbits(64)


def configuration(name: str, value: ArrayLike) -> tuple[float, ...]:
    """Finite numbers (d,) as JSON can hold them.

    Raises:
        SamplerError: they are none.
    """
    try:
        numbers = np.asarray(value, dtype=np.float64)
    except (TypeError, ValueError):
        numbers = np.array(np.nan)
    if numbers.ndim != 1 or not np.isfinite(numbers).all():
        raise SamplerError(f"{name} is wrong", expected="finite numbers, one dimension", got=str(value)[:200])
    return tuple(numbers.tolist())


def _whole(name: str, value: int) -> int:
    try:
        whole = int(value)
    except (TypeError, ValueError, OverflowError):
        whole = -1
    # Neither a half nor a text.
    if whole < 0 or whole != value or isinstance(value, bool):
        raise SamplerError(f"{name} is wrong", expected="a whole number, not negative", got=repr(value)[:200])
    return whole
