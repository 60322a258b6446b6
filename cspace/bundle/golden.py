"""The golden case: a request with the answers that its bundle gave where it was written."""

import io
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cspace.errors import BundleIntegrityError, GoldenMismatchError
from cspace.query import SampleQuery
from cspace.space import JointSpace

# Of the archive, unpacked; a picture of 2048 pixels has 12.6 MB.
MAX_ARRAYS_BYTES = 32 * 2**20
TOLERANCE = 1e-4
_QUERY = ("count", "seed", "epsilon_sigma", "start", "goal")


@dataclass(frozen=True, slots=True)
class GoldenCase:
    """Inputs with their expected outputs; None where the model has no such thing."""

    image: NDArray[np.uint8]  # (P, P, 3), or as the world's pictures are
    query: SampleQuery
    mu: NDArray[np.float32]  # (L,)
    sigma: NDArray[np.float32]  # (L,)
    samples: NDArray[np.float32]  # (n, d) rad
    confidence: NDArray[np.float32] | None = None  # (n,), models with a validity head only

    def to_npz(self) -> bytes:
        """``golden.npz``."""
        query = self.query
        values: dict[str, Any] = {
            "count": query.n,
            "seed": np.uint64(query.seed),
            "epsilon_sigma": query.epsilon_sigma,
            "start": query.start,
            "goal": query.goal,
        }
        values |= {name: getattr(self, name) for name in ("image", "mu", "sigma", "samples", "confidence")}
        buffer = io.BytesIO()
        np.savez_compressed(buffer, **{name: value for name, value in values.items() if value is not None})
        return buffer.getvalue()

    @classmethod
    def from_npz(cls, data: bytes) -> "GoldenCase":
        """The inverse of :meth:`to_npz`; never unpickles."""
        try:
            with np.load(io.BytesIO(data), allow_pickle=False) as archive:
                if sum(entry.file_size for entry in archive.zip.infolist()) > MAX_ARRAYS_BYTES:
                    raise ValueError(f"more than {MAX_ARRAYS_BYTES} bytes unpacked")  # noqa: TRY301
                values = dict(archive)
            asked = {name: values.pop(name).tolist() for name in _QUERY if name in values}
            query = SampleQuery.checked(asked.pop("count"), **asked, min_confidence=0.0)
            return cls(query=query, **values)
        except Exception as error:
            # All, for there is no list of what a damaged archive raises.
            raise BundleIntegrityError(
                "golden.npz is not a golden case",
                expected="a request and its answers, as cspace.bundle writes them",
                got=str(error)[:200] or type(error).__name__,
                remedy="export the bundle again",
            ) from error

    def compare(
        self,
        mu: NDArray[np.float32],
        sigma: NDArray[np.float32],
        samples: NDArray[np.float32],
        confidence: NDArray[np.float32] | None,
        space: JointSpace,
    ) -> None:
        """Hold a latent and answers against the expected ones, circles the shorter way round."""
        _close("mu", self.mu, mu)
        _close("sigma", self.sigma, sigma)
        _close("samples", self.samples, samples, space)
        if (self.confidence is None) != (confidence is None):
            raise GoldenMismatchError("the golden case and the bundle disagree on a validity head")
        if self.confidence is not None and confidence is not None:
            _close("confidence", self.confidence, confidence)


def _close(name: str, expected: NDArray[Any], got: NDArray[Any], space: JointSpace | None = None) -> None:
    if expected.shape != got.shape:
        raise GoldenMismatchError(f"the golden case's {name} is of shape {expected.shape}, not {got.shape}")
    gap = got.astype(np.float64) - expected if space is None else space.difference(expected, got)
    worst = float(np.max(np.abs(gap), initial=0.0))
    if not worst <= TOLERANCE:
        raise GoldenMismatchError(
            f"the golden case's {name} comes out differently here",
            expected=f"within {TOLERANCE}",
            got=f"off by {worst:.3g}",
            remedy="use the onnxruntime and numpy of the constraints file, or export the bundle again",
        )


def scene(size: Sequence[int]) -> NDArray[np.uint8]:
    """A fixed picture (P, P, 3) or (X, Y, Z, channels) without a renderer.

    A ball in the middle of space: far from it all is seen free, within and below it nothing is known.
    """
    if len(size) == 3:
        return _flat_scene(size[0])
    place = np.stack(np.meshgrid(*(np.linspace(-1.0, 1.0, side) for side in size[:-1]), indexing="ij"))
    gap = np.linalg.norm(place, axis=0) - 0.4
    hidden = (gap < 0.0) | ((np.linalg.norm(place[:2], axis=0) < 0.4) & (place[2] < 0.0))
    image = np.empty(tuple(size), dtype=np.uint8)
    image[..., 0] = np.minimum(np.abs(gap) * 1000.0, 255.0)
    image[..., 1:] = np.where(hidden, np.clip(-gap * 250.0, 1.0, 253.0), 0.0)[..., None]
    image[:2, ..., 1:] = 255
    return image


def _flat_scene(pixels: int) -> NDArray[np.uint8]:
    """In the project's colours: two discs over a stretched arm."""
    rows, columns = np.mgrid[0:pixels, 0:pixels] / pixels
    image = np.full((pixels, pixels, 3), 255, dtype=np.uint8)
    arm = (np.abs(rows - 0.5) < 0.02) & (columns > 0.5) & (columns < 0.9)
    image[arm] = (0, 0, 255)
    for row, column in ((0.3, 0.7), (0.75, 0.35)):
        image[(rows - row) ** 2 + (columns - column) ** 2 < 0.01] = (255, 0, 0)
    return image


def endpoints(conditions: Sequence[str], space: JointSpace) -> tuple[tuple[float, ...] | None, ...]:
    """A fixed start and goal for path models, None for the others."""
    if not conditions:
        return None, None
    low, width = np.asarray(space.lower), np.subtract(space.upper, space.lower)
    limited = (low + 0.25 * width, low + 0.75 * width)
    ends = (
        np.where(space.periodic, circle, inside) for circle, inside in zip((-0.5, 1.0), limited, strict=True)
    )
    return tuple(tuple(end.tolist()) for end in ends)
