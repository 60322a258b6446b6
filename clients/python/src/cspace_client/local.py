"""Samples from a bundle in this process, where a package that reads bundles is installed.

Such a package registers a function of a folder and a robot under the entry point group
``cspace_client.local``; ``cspace-sampler`` does, and needs ``onnxruntime`` for it.
"""

from importlib.metadata import entry_points
from pathlib import Path
from typing import Any

from cspace_client.errors import LocalError
from cspace_client.models import SampleBatch, Source, as_query, seeded
from cspace_client.pictures import Picture
from cspace_client.wire import SampleQuery

GROUP = "cspace_client.local"
_REMEDY = "install onnxruntime and cspace-sampler beside cspace-client, or ask a server"


class LocalClient:
    """A bundle in place of a server: used as :class:`cspace_client.SamplingClient`, or as its ``fallback``.

    ``robot`` is the digest of the robot that is planned for; a bundle of another one refuses.
    """

    def __init__(self, folder: str | Path, *, robot: str | None = None) -> None:
        found = list(entry_points(group=GROUP))
        if not found:
            raise LocalError("nothing installed reads bundles", got="no cspace-sampler", remedy=_REMEDY)
        try:
            opener = found[0].load()
        except ImportError as error:
            raise LocalError("what reads bundles cannot be loaded", got=str(error), remedy=_REMEDY) from error
        self._source: Source = opener(Path(folder), robot=robot)

    def sample(
        self, picture: Picture, n: int, seed: int | None = None, *, model: str | None = None, **options: Any
    ) -> SampleBatch:
        """As of :class:`cspace_client.SamplingClient`; ``model`` is ``pretrained`` or None."""
        return self.answer(picture, as_query(SampleQuery, n=n, seed=seed, **options), model)

    def answer(
        self, picture: Picture, query: SampleQuery, model: str | None = None, robot: str | None = None
    ) -> SampleBatch:
        """As of :class:`cspace_client.SamplingClient`."""
        return self._source.answer(picture, seeded(query), model, robot)
