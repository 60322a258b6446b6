"""What can be judged: any source of samples, and a bundle with what else it can do.

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
from cspace.query import SampleQuery
from services.planner.sources.local_sampler import BundleSampler
from services.planner.sources.samples import SampleSource

Image = NDArray[np.uint8]

# At which a path model's samples are filtered for comparison: even odds.
PATH_CONFIDENCE = 0.5


@runtime_checkable
class ScoredSampler(SampleSource, Protocol):
    """A source that can tell how sure it is of any configuration."""

    @property
    def threshold(self) -> float:
        """The confidence at which its samples are filtered, 0 to 1."""
        ...

    def score(self, image: Image, configurations: NDArray[np.float32]) -> NDArray[np.float32]:
        """P(free) of (n, d) configurations in rad, (n,)."""
        ...


class ScoredBundleSampler(BundleSampler):
    """A bundle with a validity head.

    Args:
        bundle: that answers and scores.
        threshold: as :class:`ScoredSampler` has it.
    """

    def __init__(self, bundle: Bundle, threshold: float) -> None:
        super().__init__(bundle)
        self.threshold = threshold

    def score(self, image: Image, configurations: NDArray[np.float32]) -> NDArray[np.float32]:
        """See :class:`ScoredSampler`."""
        return self.bundle.score(image, configurations)


def bundle_sampler(bundle: Bundle) -> BundleSampler:
    """A bundle with all that it can do; free samples are filtered as it recommends, those of paths alike."""
    threshold = PATH_CONFIDENCE if bundle.spec.endpoints else bundle.spec.confidence_threshold
    if threshold is None or not bundle.has_validity:
        return BundleSampler(bundle)
    return ScoredBundleSampler(bundle, threshold)


def unfiltered(sampler: SampleSource, image: Image, n: int, seed: int) -> NDArray[np.float64]:
    """``n`` configurations (n, d) rad for a picture (P, P, 3) as a model draws them.

    Raises:
        SamplerError: as the source has it.
    """
    query = SampleQuery(n, seed, min_confidence=0.0)
    return np.asarray(sampler.answer(image, query).samples, dtype=np.float64)


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
