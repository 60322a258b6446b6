"""Where samples come from: the port to a source, bundles in this process, and the inference API."""

import os
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import fields, replace
from pathlib import Path
from typing import Any, Protocol, Self

import numpy as np
from numpy.typing import NDArray
from pydantic import ValidationError

import cspace.errors
import cspace_client
from cspace.bundle import Bundle, load_verified
from cspace.bundle.spec import fitted
from cspace.errors import BundleError, InputError, SamplerError, SamplerUnavailableError, ServiceError
from cspace.query import MAX_SAMPLES, PlanQuery, SampleQuery, random_seed
from cspace.world import Examined
from cspace_client import DEFAULT_TIMEOUT_S, FoundPlan, JointSpace, PictureWarning, SampleBatch
from cspace_client.answers import as_query
from services.names import API_URL

__all__ = [
    "BundleSampler",
    "FoundPlan",
    "LocalSampler",
    "Picture",
    "SampleBatch",
    "SampleSource",
    "SamplingClient",
    "usual_api",
]

Picture = bytes | NDArray[np.uint8]
"""A scenario's picture: a PNG file, or uint8 (P, P, 3)."""


class SampleSource(Protocol):
    """Draws configurations for a picture.

    ``threshold`` is the confidence at which samples are filtered; None where there is no validity head.
    """

    threshold: float | None = None

    def score(
        self,
        image: NDArray[np.uint8],  # noqa: ARG002 - of sources with a head
        configurations: NDArray[np.float32],  # noqa: ARG002 - as above
    ) -> NDArray[np.float32]:
        """P(free) of (n, d) configurations in rad, (n,), by the validity head."""
        raise SamplerError("the source has no validity head")

    @property
    def with_ends(self) -> bool:
        """Whether it needs start and goal; False as well where only an answer shows it."""
        return False

    def answer(self, picture: Picture, query: SampleQuery, model: str | None = None) -> SampleBatch:
        """One batch of at most ``query.n`` samples; the model is a reference, None for the default."""
        ...

    def sample(
        self,
        picture: Picture,
        n: int,
        seed: int | None = None,
        *,
        model: str | None = None,
        **options: Any,
    ) -> SampleBatch:
        """:meth:`answer` to the query of these arguments; None draws a seed."""
        try:
            query = SampleQuery.checked(n, random_seed(seed), **options)
        except InputError as error:
            raise SamplerError(error.what, expected=error.expected, got=error.got) from error
        return self.answer(picture, query, model)


PRETRAINED = "pretrained"


class BundleSampler(SampleSource):
    """Answers from a loaded bundle as the inference API would, under a name and version; thread-safe.

    ``robot`` is the one that is planned for where a query names none.
    """

    def __init__(
        self, bundle: Bundle, *, name: str = PRETRAINED, version: int = 0, robot: str | None = None
    ) -> None:
        self.bundle = bundle
        self._name, self._version, self._robot = name, version, robot

    @property
    def with_ends(self) -> bool:
        """Whether it is a path model."""
        return bool(self.bundle.spec.endpoints)

    def score(self, image: NDArray[np.uint8], configurations: NDArray[np.float32]) -> NDArray[np.float32]:
        """P(free) of (n, d) configurations in rad, (n,)."""
        return self.bundle.predict(image, configurations)[0]

    def answer(self, picture: Picture, query: SampleQuery, model: str | None = None) -> SampleBatch:
        """One batch; raises SamplerError where the request does not fit the bundle."""
        if query.robot is None:
            query = replace(query, robot=self._robot)
        known = (None, self._name, f"{self._name}/{self._version}")
        if model not in known or query.n > MAX_SAMPLES:
            raise SamplerError(
                "the local bundle can not answer the request",
                expected=f"the model {self._name} and at most {MAX_SAMPLES} samples",
                got=f"{model or self._name} and {query.n}",
            )
        began = time.perf_counter()
        try:
            query = fitted(query, self.bundle.spec, has_validity=self.bundle.has_validity)
            world = self.bundle.spec.world
            read = world.examine_picture(picture) if isinstance(picture, bytes) else Examined(picture[None])
            prepared = self.bundle.prepare(read)
            found = self.bundle.answer(prepared, query, report_confidence=False)
        except (InputError, BundleError) as error:
            raise SamplerError("the local bundle refused the request", got=str(error)) from error
        total_s, space = time.perf_counter() - began, world.space
        return SampleBatch(
            samples=found.samples,
            model_name=self._name,
            model_version=self._version,
            digest=self.bundle.digest,
            seed=query.seed,
            shortfall=found.shortfall,
            round_trip_s=total_s,
            novelty=prepared.novelty,
            server_s=total_s,
            acceptance=found.acceptance,
            robot=self.bundle.robot,
            confidence=found.confidence,
            space=JointSpace(space.lower, space.upper, space.periodic),
            warnings=[PictureWarning.model_validate(one) for one in read.findings],
        )


class LocalSampler(BundleSampler):
    """Answers from a bundle's folder, which a worker process verifies first."""

    def __init__(
        self, bundle_folder: Path, *, name: str = PRETRAINED, version: int = 0, robot: str | None = None
    ) -> None:
        try:
            bundle = load_verified(Path(bundle_folder))
        except (BundleError, ServiceError) as error:
            raise SamplerUnavailableError(
                f"the bundle {bundle_folder} can not be used", got=str(error)
            ) from error
        super().__init__(bundle, name=name, version=version, robot=robot)


def usual_api() -> str:
    """The address that the shell names, or that of the default set-up."""
    return os.environ.get(API_URL) or "http://127.0.0.1:8000"


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
            asked = as_query(cspace_client.PlanQuery, **values)
            return self._client.plan(picture, asked, model)

    def close(self) -> None:
        """Close the connection."""
        self._client.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()
