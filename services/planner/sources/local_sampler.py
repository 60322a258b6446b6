"""Bundles in this process as sources of samples: no server, no network, the same samples."""

import time
from pathlib import Path

from cspace.bundle import Bundle
from cspace.bundle.request import fitted
from cspace.bundle.verification import load_verified
from cspace.errors import BundleError, InputError, SamplerError, SamplerUnavailableError, ServiceError
from cspace.query import MAX_SAMPLES, SampleQuery
from cspace.world import Examined
from cspace_client import JointSpace, PictureWarning
from services.planner.sources.samples import Picture, SampleBatch, SampleSource, SourceTiming, for_robot

PRETRAINED = "pretrained"


class BundleSampler(SampleSource):
    """Answers from a loaded bundle as the inference API would; safe to share between threads.

    Args:
        bundle: that answers.
        name: under which it answers, and the one ``model`` beside None that it accepts.
        version: its number in the registry.
        robot: that is planned for, where a query names none, as the clients have it.
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

    def answer(self, picture: Picture, query: SampleQuery, model: str | None = None) -> SampleBatch:
        """See :class:`services.planner.sources.samples.SampleSource`.

        Raises:
            SamplerError: the request does not fit the bundle.
        """
        query = for_robot(query, self._robot)
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
            decoded = time.perf_counter()
            prepared = self.bundle.prepare(read.images[0])
            encoded = time.perf_counter()
            found = self.bundle.answer(prepared, query, tell_confidence=False)
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
            timing=SourceTiming(decoded - began, encoded - decoded, 1e-3 * found.generate_ms, total_s),
            acceptance=found.acceptance,
            robot=self.bundle.robot,
            confidence=found.confidence,
            space=JointSpace(space.lower, space.upper, space.periodic),
            warnings=tuple(PictureWarning(one.code, one.message, one.pictures) for one in read.findings),
        )


class LocalSampler(BundleSampler):
    """Answers from a bundle's folder, which a worker process verifies first.

    Args:
        bundle_folder: a bundle.
        name: as :class:`BundleSampler` has it.
        version: likewise.
        robot: likewise.

    Raises:
        SamplerUnavailableError: the bundle can not be used.
    """

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
