"""The inference API's client behind the project's port of samples, with the project's errors."""

import base64
import json
import os
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import asdict, fields
from pathlib import Path
from typing import Self, TypedDict, Unpack

import httpx
from numpy.typing import ArrayLike

import cspace_client
from cspace.errors import (
    ConfigError,
    CspaceError,
    InputError,
    PlanningError,
    SamplerAnswerError,
    SamplerError,
    SamplerModelError,
    SamplerUnavailableError,
)
from cspace.query import PlanQuery, SampleQuery
from cspace.view_file import check_ages, pack_view, unstamped
from cspace_client import DEFAULT_TIMEOUT_S, FoundPlan, Predictions, RetryPolicy
from cspace_client import Plan as ServedPlan
from cspace_client.pictures import shown
from services.planner.samples import LocalSampler, Picture, SampleBatch, SampleSource

__all__ = [
    "API_URL",
    "DEFAULT_TIMEOUT_S",
    "FoundPlan",
    "RetryPolicy",
    "SamplingClient",
    "ServedPlan",
    "client_plan_query",
    "mapped",
    "open_local",
    "usual_api",
]

API_URL = "CSPACE_API_URL"
"""The variable that ``python -m services.local env`` sets in a shell."""
_USUAL = "http://127.0.0.1:8000"


def usual_api() -> str:
    """The address that the shell names, or that of the default set-up."""
    return os.environ.get(API_URL) or _USUAL


# The most special ones first.
_KINDS: tuple[tuple[type[cspace_client.ClientError], type[CspaceError]], ...] = (
    (cspace_client.SamplerAnswerError, SamplerAnswerError),
    (cspace_client.SamplerUnavailableError, SamplerUnavailableError),
    (cspace_client.SamplerModelError, SamplerModelError),
    (cspace_client.SamplerError, SamplerError),
    (cspace_client.ConfigError, ConfigError),
    (cspace_client.PlanningError, PlanningError),
    (cspace_client.ClientError, CspaceError),
)


@contextmanager
def mapped() -> Iterator[None]:
    """Errors of the client within the block leave it as those of :mod:`cspace.errors`, with their causes."""
    try:
        yield
    except cspace_client.ClientError as error:
        kind = next(ours for theirs, ours in _KINDS if isinstance(error, theirs))
        raise kind(error.what, **error.details) from error.__cause__


@contextmanager
def as_client_errors() -> Iterator[None]:
    """Raises errors of a source within the block as those that the client expects."""
    try:
        yield
    except SamplerError as error:
        kind = next(theirs for theirs, ours in _KINDS if isinstance(error, ours))
        details = {"expected": error.expected, "got": error.got, "remedy": error.remedy}
        raise kind(error.what, **details) from error


class ClientSource:
    """Answers the client's queries.

    Args:
        source: that answers.
    """

    def __init__(self, source: SampleSource) -> None:
        self._source = source

    def answer(
        self, picture: cspace_client.Picture, query: cspace_client.SampleQuery, model: str | None = None
    ) -> SampleBatch:
        """See :class:`cspace_client.Source`.

        Raises:
            cspace_client.SamplerError: it has no answer.
        """
        with as_client_errors():
            return self._source.answer(_picture(picture), _server_query(query), model)


def open_local(folder: Path, *, robot: str | None) -> ClientSource:
    """A bundle's folder, as :class:`cspace_client.local.LocalClient` opens one: this project's entry point.

    Raises:
        cspace_client.LocalError: the bundle can not be used.
    """
    try:
        return ClientSource(LocalSampler(folder, robot=robot))
    except SamplerError as error:
        raise cspace_client.LocalError(error.what, got=error.got, remedy=error.remedy) from error


def _server_query(query: cspace_client.SampleQuery) -> SampleQuery:
    try:
        return SampleQuery.checked(**asdict(query))
    except InputError as error:
        raise SamplerError(error.what, expected=error.expected, got=error.got) from error


def client_plan_query(query: PlanQuery) -> cspace_client.PlanQuery:
    """A query of the project as the client's, without what a server alone adds to it."""
    names = {one.name for one in fields(query)} & {one.name for one in fields(cspace_client.PlanQuery)}
    return cspace_client.PlanQuery(**{name: getattr(query, name) for name in names})


def _picture(picture: cspace_client.Picture) -> Picture:
    """Depth pictures, and what is known beside a picture, as the file of a view; others as they are."""
    if not isinstance(picture, cspace_client.DepthPictures | cspace_client.PlanarPicture):
        return picture
    sent = shown(picture)
    cameras = [json.loads(one) for one in sent.fields.get("camera", ())]
    state, scale, max_age_s = (
        json.loads(sent.fields.get(name, "null")) for name in ("state", "depth_scale_m", "max_age_s")
    )
    named = ("scene", "attached", "allowed", "ignore")
    known = {name: json.loads(sent.fields[name]) for name in named if name in sent.fields}
    if sent.meshes:
        known["meshes"] = {name: base64.b64encode(data).decode() for name, data, _ in sent.meshes}
    files = [data for _, data, _ in sent.files]
    if not cameras and not known:
        return files[0]
    try:
        if max_age_s is not None:
            check_ages(unstamped(cameras)[1], max_age_s, time.time())
        return pack_view(files, cameras, state, scale, json.dumps(known).encode() if known else None)
    except InputError as error:
        raise SamplerError(error.what, expected=error.expected, got=error.got) from error


class ClientOptions(TypedDict, total=False):
    """Further settings of a client; see :class:`cspace_client.SamplingClient`.

    Its ``robot`` is what :func:`cspace.worlds.robot_digest` names.
    """

    connect_timeout_s: float | None
    policy: RetryPolicy
    api_key: str | None
    fallback: cspace_client.Source | None
    transport: httpx.BaseTransport | None
    robot: str | None


class SamplingClient(SampleSource):
    """Asks an inference API for samples, predictions and paths over one kept connection.

    Args:
        url: as :class:`cspace_client.SamplingClient` has it, and so the rest.
        timeout_s: likewise.
        options: likewise; the fallback may be a :class:`ClientSource`.

    Raises:
        ConfigError: the address, a time limit, the key or the robot can not be.
    """

    def __init__(
        self, url: str, timeout_s: float = DEFAULT_TIMEOUT_S, **options: Unpack[ClientOptions]
    ) -> None:
        with mapped():
            self._client = cspace_client.SamplingClient(url, timeout_s, **options)

    def answer(self, picture: Picture, query: SampleQuery, model: str | None = None) -> SampleBatch:
        """See :class:`services.planner.samples.SampleSource`.

        Raises:
            SamplerUnavailableError: no connection, no answer in time, no model ready (503), too many requests
                (429), or a server that fails (5xx), and no fallback that answers.
            SamplerAnswerError: likewise, for an answer that can not be used.
            SamplerError: the request was refused (4xx).
        """
        with mapped():
            return self._client.answer(picture, cspace_client.SampleQuery(**asdict(query)), model)

    def validity(self, picture: Picture, configurations: ArrayLike, model: str | None = None) -> Predictions:
        """See :meth:`cspace_client.SamplingClient.validity`.

        The picture of depth cameras is a file of :func:`cspace.view_file.pack_view`.

        Raises:
            SamplerError: and its kinds, as there.
        """
        with mapped():
            return self._client.validity(picture, configurations, model)

    def plan(self, picture: Picture, query: PlanQuery, model: str | None = None) -> FoundPlan:
        """See :meth:`cspace_client.SamplingClient.plan`; the picture is as :meth:`validity` has it.

        Raises:
            SamplerError: and its kinds, as there.
        """
        with mapped():
            return self._client.plan(picture, client_plan_query(query), model)

    def close(self) -> None:
        """Close the connection."""
        self._client.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()
