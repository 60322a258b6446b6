"""A bundle in this process as a source of samples: no server, no network, the same samples."""

import time
from collections.abc import Sequence
from pathlib import Path

from cspace.bundle import Bundle
from cspace.errors import BundleError, InputError, SamplerError, SamplerUnavailableError
from services.planner.sources.samples import MAX_SAMPLES, SampleBatch, SourceTiming, drawn_seed

PRETRAINED = "pretrained"


class LocalSampler:
    """Answers from a bundle's folder as the inference API would; safe to share between threads.

    Args:
        bundle_folder: a bundle.
        name: under which it answers, and the one ``model`` beside None that it accepts.
        version: its number in the registry.

    Raises:
        SamplerUnavailableError: the bundle can not be used.
    """

    def __init__(self, bundle_folder: Path, *, name: str = PRETRAINED, version: int = 0) -> None:
        try:
            self._bundle = Bundle.load(Path(bundle_folder))
        except BundleError as error:
            raise SamplerUnavailableError(
                f"the bundle {bundle_folder} can not be used", got=str(error)
            ) from error
        self._name, self._version = name, version

    def sample(
        self,
        image_png: bytes,
        n: int,
        *,
        model: str | None = None,
        seed: int | None = None,
        epsilon_sigma: Sequence[float] = (),
        start: Sequence[float] | None = None,
        goal: Sequence[float] | None = None,
        min_confidence: float | None = None,
    ) -> SampleBatch:
        """See :class:`services.planner.sources.samples.SampleSource`.

        Raises:
            SamplerError: the request does not fit the bundle.
        """
        known = (None, self._name, f"{self._name}/{self._version}")
        if model not in known or n > MAX_SAMPLES:
            raise SamplerError(
                "the local bundle can not answer the request",
                expected=f"the model {self._name} and at most {MAX_SAMPLES} samples",
                got=f"{model or self._name} and {n}",
            )
        seed = drawn_seed(seed)
        began = time.perf_counter()
        try:
            image = self._bundle.spec.world.sensor.decode(image_png)
            decoded = time.perf_counter()
            picture = self._bundle.prepare(image)
            encoded = time.perf_counter()
            found = self._bundle.sample(
                picture,
                n,
                seed,
                epsilon_sigma=tuple(epsilon_sigma) or (0.0,),
                start=start,
                goal=goal,
                min_confidence=min_confidence,
                tell_confidence=False,
            )
        except (InputError, BundleError) as error:
            raise SamplerError("the local bundle refused the request", got=str(error)) from error
        total_s = time.perf_counter() - began
        return SampleBatch(
            samples=found.samples,
            model_name=self._name,
            model_version=self._version,
            digest=self._bundle.digest,
            seed=seed,
            shortfall=found.shortfall,
            round_trip_s=total_s,
            novelty=picture.novelty,
            timing=SourceTiming(decoded - began, encoded - decoded, 1e-3 * found.generate_ms, total_s),
        )
