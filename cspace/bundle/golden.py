"""The golden case: a request with the answers that its bundle gave where it was written."""

import io
import zipfile
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cspace.errors import BundleIntegrityError, GoldenMismatchError
from cspace.space import difference

TOLERANCE = 1e-4
_REQUEST = ("image", "count", "seed", "epsilon_sigma", "start", "goal")
_ANSWERS = ("mu", "sigma", "samples", "confidence")


@dataclass(frozen=True, slots=True)
class GoldenCase:
    """Inputs with their expected outputs; None where the model has no such thing.

    Args:
        image: uint8 (P, P, 3).
        count: samples asked for.
        seed: unsigned 64 bit.
        epsilon_sigma: the schedule.
        mu: float32 (L,).
        sigma: float32 (L,).
        samples: float32 (count, d) rad.
        start: (d,) rad, path models only.
        goal: (d,) rad, path models only.
        confidence: float32 (count,), models with a validity head only.
    """

    image: NDArray[np.uint8]
    count: int
    seed: int
    epsilon_sigma: tuple[float, ...]
    mu: NDArray[np.float32]
    sigma: NDArray[np.float32]
    samples: NDArray[np.float32]
    start: tuple[float, ...] | None = None
    goal: tuple[float, ...] | None = None
    confidence: NDArray[np.float32] | None = None

    def to_npz(self) -> bytes:
        """``golden.npz``."""
        values: dict[str, Any] = {name: getattr(self, name) for name in (*_REQUEST, *_ANSWERS)}
        values["seed"] = np.uint64(self.seed)
        buffer = io.BytesIO()
        np.savez_compressed(buffer, **{name: value for name, value in values.items() if value is not None})
        return buffer.getvalue()

    @classmethod
    def from_npz(cls, data: bytes) -> "GoldenCase":
        """The inverse of :meth:`to_npz`; never unpickles.

        Raises:
            BundleIntegrityError: not a golden case.
        """
        try:
            with np.load(io.BytesIO(data), allow_pickle=False) as archive:
                values = {name: archive[name] for name in archive.files}
            return cls(
                values["image"],
                int(values["count"]),
                int(values["seed"]),
                tuple(values["epsilon_sigma"].tolist()),
                values["mu"],
                values["sigma"],
                values["samples"],
                tuple(values["start"].tolist()) if "start" in values else None,
                tuple(values["goal"].tolist()) if "goal" in values else None,
                values.get("confidence"),
            )
        except (
            KeyError,
            ValueError,
            TypeError,
            OSError,
            EOFError,
            AttributeError,
            zipfile.BadZipFile,
        ) as error:
            raise BundleIntegrityError(
                "golden.npz is not a golden case", expected=f"arrays {_REQUEST + _ANSWERS}", got=str(error)
            ) from error

    def compare(
        self,
        mu: NDArray[np.float32],
        sigma: NDArray[np.float32],
        samples: NDArray[np.float32],
        confidence: NDArray[np.float32] | None,
    ) -> None:
        """Hold answers against the expected ones, angles the shorter way round.

        Raises:
            GoldenMismatchError: one differs by more than 1e-4, or in shape.
        """
        _close("mu", self.mu, mu)
        _close("sigma", self.sigma, sigma)
        _close("samples", self.samples, samples, angles=True)
        if (self.confidence is None) != (confidence is None):
            raise GoldenMismatchError("the golden case and the bundle disagree on a validity head")
        if self.confidence is not None and confidence is not None:
            _close("confidence", self.confidence, confidence)


def _close(name: str, expected: NDArray[Any], got: NDArray[Any], *, angles: bool = False) -> None:
    if expected.shape != got.shape:
        raise GoldenMismatchError(
            f"the golden case's {name} has another shape", expected=str(expected.shape), got=str(got.shape)
        )
    gap = difference(expected, got) if angles else got.astype(np.float64) - expected
    worst = float(np.max(np.abs(gap), initial=0.0))
    if not worst <= TOLERANCE:
        raise GoldenMismatchError(
            f"the golden case's {name} comes out differently here",
            expected=f"within {TOLERANCE}",
            got=f"off by {worst:.3g}",
            remedy="use the onnxruntime and numpy of the constraints file, or export the bundle again",
        )


def scene(pixels: int) -> NDArray[np.uint8]:
    """A fixed picture in the project's colours without the renderer: two discs over a stretched arm."""
    rows, columns = np.mgrid[0:pixels, 0:pixels] / pixels
    image = np.full((pixels, pixels, 3), 255, dtype=np.uint8)
    arm = (np.abs(rows - 0.5) < 0.02) & (columns > 0.5) & (columns < 0.9)
    image[arm] = (0, 0, 255)
    for row, column in ((0.3, 0.7), (0.75, 0.35)):
        image[(rows - row) ** 2 + (columns - column) ** 2 < 0.01] = (255, 0, 0)
    return image


def endpoints(conditions: Sequence[str], dim: int) -> tuple[tuple[float, ...] | None, ...]:
    """A fixed start and goal for path models, None for the others."""
    if not conditions:
        return None, None
    return tuple([-0.5] * dim), tuple([1.0] * dim)
