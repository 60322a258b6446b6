"""A source of this project as the client asks one: its fallback, and what it opens where no server is."""

import json
from pathlib import Path

import cspace_client
from cspace.errors import ImageError, InputError, SamplerError
from cspace.query import SampleQuery
from cspace.view_file import pack_view
from cspace_client.pictures import shown
from services.planner.sources.client_errors import told_to_client
from services.planner.sources.local_sampler import LocalSampler
from services.planner.sources.samples import Picture, SampleBatch, SampleSource


class ClientSource:
    """Answers the client's queries.

    Args:
        source: that answers.
    """

    def __init__(self, source: SampleSource) -> None:
        self._source = source

    def answer(
        self, picture: cspace_client.Picture, query: cspace_client.Wanted, model: str | None = None
    ) -> SampleBatch:
        """See :class:`cspace_client.Source`.

        Raises:
            cspace_client.SamplerError: it has no answer.
        """
        with told_to_client():
            return self._source.answer(_picture(picture), _judged(query), model)


def open_local(folder: Path, *, robot: str | None) -> ClientSource:
    """A bundle's folder, as :class:`cspace_client.local.LocalClient` opens one: this project's entry point.

    Raises:
        cspace_client.LocalError: the bundle can not be used.
    """
    try:
        return ClientSource(LocalSampler(folder, robot=robot))
    except SamplerError as error:
        raise cspace_client.LocalError(error.what, got=error.got, remedy=error.remedy) from error


def _judged(query: cspace_client.Wanted) -> SampleQuery:
    if isinstance(query, SampleQuery):
        return query
    try:
        return SampleQuery.checked(
            query.n,
            query.seed,
            query.epsilon_sigma,
            query.start,
            query.goal,
            query.min_confidence,
            query.robot,
        )
    except InputError as error:
        raise SamplerError(error.what, expected=error.expected, got=error.got) from error


def _picture(picture: cspace_client.Picture) -> Picture:
    """Depth pictures as the file of a view, others as they are."""
    if not isinstance(picture, cspace_client.DepthPictures):
        return picture
    sent = shown(picture)
    cameras = [json.loads(one) for one in sent.fields["camera"]]
    state, scale = (json.loads(sent.fields.get(name, "null")) for name in ("state", "depth_scale_m"))
    try:
        return pack_view([data for _, data, _ in sent.files], cameras, state, scale)
    except ImageError as error:
        raise SamplerError(error.what, expected=error.expected, got=error.got) from error
