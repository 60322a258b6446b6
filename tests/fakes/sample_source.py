"""A source of samples in this process, with the rules of the sampling endpoint and no network."""

from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray

from cspace.errors import SamplerError, SamplerUnavailableError
from cspace.space import to_float32
from services.planner.sources.samples import SampleBatch

MODEL = "pretrained"
DIGEST = "f" * 64
MAX_SAMPLES = 20_000

Draw = Callable[[np.random.Generator, int], NDArray[np.float64]]


def uniform_pairs(rng: np.random.Generator, n: int) -> NDArray[np.float64]:
    """(n, 2) uniform on the torus of two joints."""
    return rng.uniform(-np.pi, np.pi, (n, 2))


class FakeSampleSource:
    """Draws by a function of a generator and a count; remembers what it was asked.

    Half the samples, drawn as confidence, fall below a ``min_confidence`` of 0.5.
    """

    def __init__(self, draw: Draw = uniform_pairs, *, ready: bool = True) -> None:
        self.draw, self.ready = draw, ready
        self.requests: list[dict[str, object]] = []

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
        self.requests.append(
            {
                "image_png": image_png,
                "n": n,
                "model": model,
                "seed": seed,
                "epsilon_sigma": tuple(epsilon_sigma),
                "start": start,
                "goal": goal,
                "min_confidence": min_confidence,
            }
        )
        if not self.ready:
            raise SamplerUnavailableError("no model is ready")
        if model not in (None, MODEL):
            raise SamplerError("No such model", got=str(model))
        if not image_png.startswith(b"\x89PNG") or not 1 <= n <= MAX_SAMPLES:
            raise SamplerError("A field is wrong", expected="a PNG and 1 to 20000 samples")
        if start is not None or goal is not None:
            raise SamplerError("A field is wrong", expected="no start and goal for a model of configurations")
        seed = len(self.requests) if seed is None else seed
        rng = np.random.default_rng(seed)
        samples = to_float32(self.draw(rng, n))
        kept = samples[rng.random(n) >= (min_confidence or 0.0)]
        return SampleBatch(kept, MODEL, 0, DIGEST, seed, n - len(kept), 0.0)
