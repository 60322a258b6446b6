"""A batch of learned samples, and the port to whatever gives one for a picture."""

from dataclasses import dataclass, replace
from typing import Protocol, TypeVar, Unpack

import numpy as np
from numpy.typing import NDArray

from cspace.errors import InputError, SamplerError
from cspace.query import QueryOptions, SampleQuery, drawn_seed

Picture = bytes | NDArray[np.uint8]
"""A scenario's picture: a PNG file, or uint8 (P, P, 3)."""

Answer_co = TypeVar("Answer_co", covariant=True)


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
        robot: whose configurations they are, as :func:`cspace.worlds.robot_digest` names it; None where it is
            not told.
        alias_confirmed: whether the server is sure of what the model's alias stands for; None where it is not
            told.
        confidence: (n,) float32, what the model's validity head scores each sample, 0 to 1; None for a model
            without one, for samples that were not filtered by it, and over HTTP, whose ``.npy`` has no room
            for it.
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


class Answering(Protocol[Answer_co]):
    """Whatever is asked for samples; what it answers is a batch, or one to be awaited."""

    def answer(self, picture: Picture, query: SampleQuery, model: str | None = None) -> Answer_co:
        """One batch of at most ``query.n`` samples.

        Args:
            picture: of the scenario.
            query: what is asked; its ``n`` is at most ``MAX_SAMPLES``.
            model: ``name``, ``name@alias``, ``name/version`` or ``pretrained``; None for the default.

        Raises:
            SamplerUnavailableError: the source does not answer or has no model ready.
            SamplerError: it refused the request; of this kind, SamplerAnswerError: its answer can not be
                used.
        """
        ...

    def sample(
        self,
        picture: Picture,
        n: int,
        seed: int | None = None,
        *,
        model: str | None = None,
        **options: Unpack[QueryOptions],
    ) -> Answer_co:
        """:meth:`answer` to the query of these arguments, which :class:`cspace.query.SampleQuery` tells of.

        Without a seed one is drawn here.

        Raises:
            SamplerUnavailableError: as :meth:`answer` has it.
            SamplerError: likewise, or a value is out of its range.
        """
        try:
            query = SampleQuery.checked(n, drawn_seed(seed), **options)
        except InputError as error:
            raise SamplerError(error.what, expected=error.expected, got=error.got) from error
        return self.answer(picture, query, model)


class SampleSource(Answering[SampleBatch], Protocol):
    """Draws configurations for a picture."""

    @property
    def with_ends(self) -> bool:
        """Whether it has to be asked with start and goal; False as well where only an answer tells."""
        return False


def for_robot(query: SampleQuery, robot: str | None) -> SampleQuery:
    """A query for the robot that it names, else for this one."""
    return query if robot is None or query.robot is not None else replace(query, robot=robot)


class PinnedSource(SampleSource):
    """A source of which one model is asked.

    Args:
        source: that answers.
        model: the one that it is asked for.
    """

    def __init__(self, source: SampleSource, model: str) -> None:
        self._source, self._model = source, model

    def answer(self, picture: Picture, query: SampleQuery, model: str | None = None) -> SampleBatch:
        """See :class:`SampleSource`; another model can be named all the same."""
        return self._source.answer(picture, query, model or self._model)
