"""The inference API's client behind the project's port of samples, with the project's errors."""

import os
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import fields
from typing import Any, Self

from pydantic import ValidationError

import cspace.errors
import cspace_client
from cspace.query import PlanQuery, SampleQuery
from cspace_client import DEFAULT_TIMEOUT_S, FoundPlan
from cspace_client.models import as_query
from services.planner.samples import Picture, SampleBatch, SampleSource

__all__ = ["API_URL", "FoundPlan", "SamplingClient", "usual_api"]

API_URL = "CSPACE_API_URL"
"""The variable that ``python -m services.local env`` sets in a shell."""
_USUAL = "http://127.0.0.1:8000"


def usual_api() -> str:
    """The address that the shell names, or that of the default set-up."""
    return os.environ.get(API_URL) or _USUAL


@contextmanager
def _mapped() -> Iterator[None]:
    """Raises errors of the client as those of the same names in :mod:`cspace.errors`."""
    try:
        yield
    except cspace_client.ClientError as error:
        names = (one.__name__ for one in type(error).__mro__)
        kind = next(
            getattr(cspace.errors, name) for name in (*names, "CspaceError") if hasattr(cspace.errors, name)
        )
        raise kind(error.what, **error.details) from error.__cause__
    except ValidationError as error:
        raise cspace.errors.SamplerError("no request has such values", got=str(error)) from error


class SamplingClient(SampleSource):
    """Asks an inference API for samples and paths; options as of the client that it wraps.

    Pictures of depth cameras are files of :func:`cspace.view_file.pack_view`.
    """

    def __init__(self, url: str, timeout_s: float = DEFAULT_TIMEOUT_S, **options: Any) -> None:
        with _mapped():
            self._client = cspace_client.SamplingClient(url, timeout_s, **options)

    def answer(self, picture: Picture, query: SampleQuery, model: str | None = None) -> SampleBatch:
        """One batch of at most ``query.n`` samples."""
        # The client has the robot beside its query.
        values = {one.name: getattr(query, one.name) for one in fields(query) if one.name != "robot"}
        with _mapped():
            asked = as_query(cspace_client.SampleQuery, **values)
            return self._client.answer(picture, asked, model, query.robot)

    def plan(self, picture: Picture, query: PlanQuery, model: str | None = None) -> FoundPlan:
        """A path, or why there is none."""
        # A server alone adds the other fields.
        known = [one.name for one in fields(query) if one.name in cspace_client.PlanQuery.model_fields]
        values = {name: getattr(query, name) for name in known}
        with _mapped():
            asked = as_query(cspace_client.PlanQuery, view=query.views or None, **values)
            return self._client.plan(picture, asked, model)

    def close(self) -> None:
        """Close the connection."""
        self._client.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()
