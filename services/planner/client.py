"""The inference API's client behind the project's port of samples, with the project's errors."""

import os
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import fields
from typing import Any, Self

from numpy.typing import ArrayLike
from pydantic import ValidationError

import cspace_client
from cspace.errors import (
    ConfigError,
    CspaceError,
    PlanningError,
    SamplerAnswerError,
    SamplerError,
    SamplerModelError,
    SamplerUnavailableError,
)
from cspace.query import PlanQuery, SampleQuery
from cspace_client import DEFAULT_TIMEOUT_S, FoundPlan, Predictions
from cspace_client.models import as_query
from services.planner.samples import Picture, SampleBatch, SampleSource

__all__ = [
    "API_URL",
    "DEFAULT_TIMEOUT_S",
    "FoundPlan",
    "SamplingClient",
    "client_plan_query",
    "client_sample_query",
    "mapped",
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
    """Raises errors of the client within the block as those of :mod:`cspace.errors`, with their causes."""
    try:
        yield
    except cspace_client.ClientError as error:
        kind = next(ours for theirs, ours in _KINDS if isinstance(error, theirs))
        raise kind(error.what, **error.details) from error.__cause__
    except ValidationError as error:
        raise SamplerError("no request has such values", got=str(error)) from error


def client_sample_query(query: SampleQuery) -> cspace_client.SampleQuery:
    """A query of the project as the client's, which has the robot beside it."""
    values = {one.name: getattr(query, one.name) for one in fields(query) if one.name != "robot"}
    return as_query(cspace_client.SampleQuery, **values)


def client_plan_query(query: PlanQuery) -> cspace_client.PlanQuery:
    """A query of the project as the client's, without what a server alone adds to it."""
    values = {one.name: getattr(query, one.name) for one in fields(query)}
    known = cspace_client.PlanQuery.model_fields
    return as_query(
        cspace_client.PlanQuery,
        view=values["views"] or None,
        **{name: value for name, value in values.items() if name in known},
    )


class SamplingClient(SampleSource):
    """Asks an inference API for samples, predictions and paths; options as of the client that it wraps.

    Pictures of depth cameras are files of :func:`cspace.view_file.pack_view`.
    """

    def __init__(self, url: str, timeout_s: float = DEFAULT_TIMEOUT_S, **options: Any) -> None:
        with mapped():
            self._client = cspace_client.SamplingClient(url, timeout_s, **options)

    def answer(self, picture: Picture, query: SampleQuery, model: str | None = None) -> SampleBatch:
        """One batch of at most ``query.n`` samples."""
        with mapped():
            return self._client.answer(picture, client_sample_query(query), model, query.robot)

    def validity(self, picture: Picture, configurations: ArrayLike, model: str | None = None) -> Predictions:
        """Confidence of configurations (n, d) rad."""
        with mapped():
            return self._client.validity(picture, configurations, model)

    def plan(self, picture: Picture, query: PlanQuery, model: str | None = None) -> FoundPlan:
        """A path, or why there is none."""
        with mapped():
            return self._client.plan(picture, client_plan_query(query), model)

    def close(self) -> None:
        """Close the connection."""
        self._client.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()
