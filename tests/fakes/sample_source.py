"""A source of samples in this process, with the rules of the sampling endpoint and no network."""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from cspace.errors import SamplerError, SamplerUnavailableError
from cspace.files import encode_png
from cspace.query import MAX_SAMPLES, SampleQuery
from cspace.space import circles
from services.planner.samples import Picture, SampleBatch, SampleSource

MODEL = "pretrained"
DIGEST = "f" * 64

Draw = Callable[[np.random.Generator, int], NDArray[np.float64]]


def uniform_pairs(rng: np.random.Generator, n: int) -> NDArray[np.float64]:
    """(n, 2) uniform on the torus of two joints."""
    return rng.uniform(-np.pi, np.pi, (n, 2))


class Received(NamedTuple):
    """What a source was asked."""

    image_png: bytes
    query: SampleQuery
    model: str | None


class FakeSampleSource(SampleSource):
    """Draws by a function of a generator and a count; remembers what it was asked.

    Half the samples, drawn as confidence, fall below a ``min_confidence`` of 0.5.
    """

    def __init__(self, draw: Draw = uniform_pairs, *, ready: bool = True) -> None:
        self.draw, self.ready = draw, ready
        self.requests: list[Received] = []

    def answer(self, picture: Picture, query: SampleQuery, model: str | None = None) -> SampleBatch:
        png = picture if isinstance(picture, bytes) else encode_png(picture)
        self.requests.append(Received(png, query, model))
        if not self.ready:
            raise SamplerUnavailableError("no model is ready")
        if model not in (None, MODEL):
            raise SamplerError("No such model", got=str(model))
        if not png.startswith(b"\x89PNG") or query.n > MAX_SAMPLES:
            raise SamplerError("A field is wrong", expected="a PNG and 1 to 20000 samples")
        if query.start is not None or query.goal is not None:
            raise SamplerError("A field is wrong", expected="no start and goal for a model of configurations")
        rng = np.random.default_rng(query.seed)
        drawn = self.draw(rng, query.n)
        samples = circles(drawn.shape[1]).to_float32(drawn)
        confidence = rng.random(query.n, dtype=np.float32)
        passed = confidence >= (query.min_confidence or 0.0)
        kept = samples[passed]
        shown = confidence[passed] if query.min_confidence else None
        return SampleBatch(kept, MODEL, 0, DIGEST, query.seed, query.n - len(kept), 0.0, confidence=shown)
