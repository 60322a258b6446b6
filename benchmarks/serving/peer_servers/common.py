"""What every peer does with a request: JSON with a picture in base64, JSON with the samples back."""

import base64
import os
from pathlib import Path

from cspace.bundle import Bundle
from cspace.worlds.planar.seeing.picture import decode_png


class Model:
    """The bundle that ``CSPACE_PEER_BUNDLE`` names."""

    def __init__(self) -> None:
        self.bundle = Bundle.load(Path(os.environ["CSPACE_PEER_BUNDLE"]))

    def answer(self, image: str, n: int, seed: int) -> dict[str, object]:
        """Samples and their confidence as lists."""
        picture = decode_png(base64.b64decode(image), self.bundle.spec.pixels)
        found = self.bundle.sample(picture, n, seed)
        return {"samples": found.samples.tolist(), "confidence": found.confidence.tolist()}
