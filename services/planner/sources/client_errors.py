"""The client's errors as those of the project's tree, and back for what stands in for a server."""

from collections.abc import Iterator
from contextlib import contextmanager

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
def told_to_client() -> Iterator[None]:
    """Errors of a source within the block leave it as those that the client expects of one."""
    try:
        yield
    except SamplerError as error:
        kind = next(theirs for theirs, ours in _KINDS if isinstance(error, ours))
        details = {"expected": error.expected, "got": error.got, "remedy": error.remedy}
        raise kind(error.what, **details) from error
