"""The port to whatever gives a batch of learned samples for a picture."""

from dataclasses import replace
from typing import Protocol, TypeVar, Unpack

import numpy as np
from numpy.typing import NDArray

from cspace.errors import InputError, SamplerError
from cspace.query import QueryOptions, SampleQuery, drawn_seed
from cspace_client import SampleBatch, SourceTiming

__all__ = ["Answering", "Picture", "PinnedSource", "SampleBatch", "SampleSource", "SourceTiming", "for_robot"]

Picture = bytes | NDArray[np.uint8]
"""A scenario's picture: a PNG file, or uint8 (P, P, 3)."""

Answer_co = TypeVar("Answer_co", covariant=True)


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
