"""Samples from a bundle in this process, where something is installed that can draw them.

This package reads no bundles. Who does registers a function of a folder and a robot under the entry point
group ``cspace_client.local``; ``cspace-sampler`` does, and needs ``onnxruntime`` for it.
"""

from collections.abc import Callable
from importlib.metadata import entry_points
from pathlib import Path
from typing import Unpack, cast

from cspace_client.errors import LocalError
from cspace_client.models import QueryOptions, SampleBatch, SampleQuery, Source
from cspace_client.pictures import Picture

GROUP = "cspace_client.local"
"""Of the entry points."""

_REMEDY = "install onnxruntime and cspace-sampler beside cspace-client, or ask a server"


class LocalClient:
    """A bundle in place of a server: asked as :class:`cspace_client.SamplingClient`, or its ``fallback``.

    Args:
        folder: of the bundle.
        robot: that is planned for, where a query names none; a bundle of another one refuses.

    Raises:
        LocalError: nothing that is installed reads bundles, or this one can not be used.
    """

    def __init__(self, folder: str | Path, *, robot: str | None = None) -> None:
        self._source = _opener()(Path(folder), robot=robot)

    def sample(
        self,
        picture: Picture,
        n: int,
        seed: int | None = None,
        *,
        model: str | None = None,
        **options: Unpack[QueryOptions],
    ) -> SampleBatch:
        """See :meth:`cspace_client.SamplingClient.sample`; ``model`` is ``pretrained`` or None.

        Raises:
            SamplerError: the request does not fit the bundle.
        """
        return self.answer(picture, SampleQuery.of(n, seed, **options), model)

    def answer(self, picture: Picture, query: SampleQuery, model: str | None = None) -> SampleBatch:
        """See :meth:`cspace_client.SamplingClient.answer`.

        Raises:
            SamplerError: the request does not fit the bundle.
        """
        return self._source.answer(picture, query, model)


def _opener() -> Callable[..., Source]:
    """The function of a folder and ``robot`` that opens a bundle, or raises LocalError."""
    found = list(entry_points(group=GROUP))
    if not found:
        raise LocalError("nothing that is installed reads bundles", got="no cspace-sampler", remedy=_REMEDY)
    try:
        return cast("Callable[..., Source]", found[0].load())
    except ImportError as error:
        raise LocalError(
            "what reads bundles can not be loaded", got=str(error)[:200], remedy=_REMEDY
        ) from error
