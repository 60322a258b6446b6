"""What can be judged: anything that turns a picture, or a picture with start and goal, into configurations.

A bundle in this process, a version behind the inference API, and the uniform sampler are all the same to the
metrics.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from cspace.bundle import Bundle
from cspace.space import JointSpace, to_float32
from cspace.worlds.planar.picture import encode_png
from services.planner.sources.sampling_client import SamplingClient

Image = NDArray[np.uint8]
Samples = NDArray[np.float32]
Ends = NDArray[np.float64]


class Sampler(Protocol):
    """Draws configurations for a picture."""

    def sample(self, image: Image, n: int, seed: int) -> Samples:
        """``n`` configurations (n, d) rad for a picture (P, P, 3), the same ones for the same seed."""
        ...


@dataclass(frozen=True, slots=True, eq=False)
class Confident:
    """Samples that reached a sampler's threshold.

    Args:
        samples: (n', d) rad, n' as many as were asked for or fewer where so few pass.
        acceptance: share of what was drawn that passed.
    """

    samples: Samples
    acceptance: float


@runtime_checkable
class ScoredSampler(Sampler, Protocol):
    """A sampler that can tell how sure it is of any configuration."""

    @property
    def threshold(self) -> float:
        """The confidence that its makers recommend."""
        ...

    def score(self, image: Image, configurations: Samples) -> Samples:
        """P(free) of (n, d) configurations in rad, (n,)."""
        ...

    def confident(self, image: Image, n: int, seed: int) -> Confident:
        """``n`` configurations whose score reaches the threshold, drawn as they are served."""
        ...


@runtime_checkable
class PathSampler(Protocol):
    """Draws configurations for a picture with start and goal."""

    def between(
        self, image: Image, start: Ends, goal: Ends, n: int, seed: int, min_confidence: float = 0.0
    ) -> Samples:
        """``n`` configurations (n, d) rad, the same ones for the same arguments.

        Args:
            image: uint8 (P, P, 3).
            start: (d,) rad.
            goal: (d,) rad.
            n: how many; fewer come where too few reach the confidence.
            seed: unsigned 64 bit.
            min_confidence: what a validity head has to score.
        """
        ...


AnySampler = Sampler | PathSampler


@dataclass(frozen=True)
class BundleSampler:
    """A bundle in this process.

    Args:
        bundle: a loaded bundle for configurations.
        epsilon_sigma: what the encoder's standard deviation is raised by, in equal shares.
        min_confidence: what the validity head has to score; 0 takes the samples as they come.
    """

    bundle: Bundle
    epsilon_sigma: tuple[float, ...] = (0.0,)
    min_confidence: float = 0.0

    def sample(self, image: Image, n: int, seed: int) -> Samples:
        """See :class:`Sampler`; fewer than ``n`` where the validity head lets too few pass."""
        drawn = self.bundle.sample(
            image, n, seed, epsilon_sigma=self.epsilon_sigma, min_confidence=self.min_confidence
        )
        return drawn.samples


@dataclass(frozen=True)
class ScoredBundleSampler(BundleSampler):
    """A bundle with a validity head.

    Args:
        threshold: the confidence that the bundle recommends.
    """

    threshold: float = 0.5

    def score(self, image: Image, configurations: Samples) -> Samples:
        """See :class:`ScoredSampler`."""
        return self.bundle.score(image, configurations)

    def confident(self, image: Image, n: int, seed: int) -> Confident:
        """See :class:`ScoredSampler`."""
        least = max(self.min_confidence, self.threshold)
        drawn = self.bundle.sample(image, n, seed, epsilon_sigma=self.epsilon_sigma, min_confidence=least)
        return Confident(drawn.samples, drawn.acceptance)


@dataclass(frozen=True)
class PathBundleSampler:
    """A bundle for paths in this process."""

    bundle: Bundle

    def between(
        self, image: Image, start: Ends, goal: Ends, n: int, seed: int, min_confidence: float = 0.0
    ) -> Samples:
        """See :class:`PathSampler`."""
        least = min_confidence if self.bundle.has_validity else 0.0
        drawn = self.bundle.sample(image, n, seed, start=start, goal=goal, min_confidence=least)
        return drawn.samples


def any_sampler(bundle: Bundle) -> AnySampler:
    """A bundle of either kind with all that it can do, none of its samples dropped."""
    return PathBundleSampler(bundle) if bundle.spec.kind == "path" else bundle_sampler(bundle)


def bundle_sampler(bundle: Bundle) -> BundleSampler:
    """A bundle for configurations with all that it can do, none of its samples dropped."""
    threshold = bundle.spec.confidence_threshold
    if threshold is None or not bundle.has_validity:
        return BundleSampler(bundle)
    return ScoredBundleSampler(bundle, threshold=threshold)


@dataclass(frozen=True)
class HttpSampler:
    """A version behind the inference API.

    Args:
        client: the API's client.
        model: ``name``, ``name@alias``, ``name/version`` or ``pretrained``; None for the API's default.
        epsilon_sigma: as for the bundle; empty for the API's default.
        min_confidence: as for the bundle; None for the model's own threshold.
    """

    client: SamplingClient
    model: str | None = None
    epsilon_sigma: tuple[float, ...] = ()
    min_confidence: float | None = 0.0

    def sample(self, image: Image, n: int, seed: int) -> Samples:
        """See :class:`Sampler`.

        Raises:
            SamplerUnavailableError: the API does not answer.
            SamplerError: it refused the request.
        """
        batch = self.client.sample(
            encode_png(image),
            n,
            model=self.model,
            seed=seed,
            epsilon_sigma=self.epsilon_sigma,
            min_confidence=self.min_confidence,
        )
        return batch.samples


@dataclass(frozen=True)
class UniformSampler:
    """The baseline that looks at no picture."""

    space: JointSpace

    def sample(self, image: Image, n: int, seed: int) -> Samples:  # noqa: ARG002 - the protocol's picture
        """``n`` uniform configurations."""
        return to_float32(self.space.sample_uniform(np.random.default_rng(seed), n))


@dataclass(frozen=True)
class PackedBundle:
    """A bundle's files as bytes, for workers that share no file system; told apart by the digest.

    Args:
        digest: of the bundle.
        files: contents by name.
    """

    digest: str
    files: Mapping[str, bytes] = field(compare=False, repr=False)

    @classmethod
    def pack(cls, bundle: Bundle) -> "PackedBundle":
        """The files of a loaded bundle."""
        paths = sorted(path for path in bundle.folder.rglob("*") if path.is_file())
        named = {path.relative_to(bundle.folder).as_posix(): path.read_bytes() for path in paths}
        return cls(bundle.digest, named)

    def load(self) -> Bundle:
        """The bundle, verified again; it keeps what it needs in memory.

        Raises:
            BundleError: it did not survive the journey, or answers differently on this machine.
        """
        with TemporaryDirectory(prefix="cspace-bundle-") as folder:
            return Bundle.load(self.unpack(Path(folder)))

    def unpack(self, folder: Path) -> Path:
        """Write the files into a folder, and return it."""
        for name, data in self.files.items():
            target = folder / name
            target.parent.mkdir(parents=True, exist_ok=True)
            target.write_bytes(data)
        return folder
