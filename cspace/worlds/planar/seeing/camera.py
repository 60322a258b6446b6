"""The camera above the plane: what its pictures show, and how they are read and written."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cspace.png import encode_png
from cspace.strict_json import settle, written
from cspace.world import Between
from cspace.worlds.planar.seeing.picture import decode_png, from_network, to_network


@dataclass(frozen=True, slots=True)
class Camera:
    """The part of the plane that the picture shows, y up, and its size in pixels (square)."""

    x_min_m: float = -5.0
    x_max_m: float = 5.0
    y_min_m: float = -5.0
    y_max_m: float = 5.0
    pixels: int = 48

    def __post_init__(self) -> None:
        settle(self)

    def to_dict(self) -> dict[str, Any]:
        """Plain values for JSON."""
        return written(self)

    @property
    def picture_shape(self) -> tuple[int, ...]:
        """(P, P, 3): RGB."""
        return (self.pixels, self.pixels, 3)

    @property
    def convention(self) -> dict[str, Any]:
        """What a bundle says of its pictures."""
        return {"pixels": self.pixels, "channels": "RGB", "range": [-1, 1]}

    @property
    def extent_m(self) -> tuple[float, float, float, float]:
        """Left, right, bottom and top of the picture."""
        return (self.x_min_m, self.x_max_m, self.y_min_m, self.y_max_m)

    def decode(self, data: bytes, between: Between | None = None) -> NDArray[np.uint8]:
        """See :func:`cspace.worlds.planar.seeing.picture.decode_png`."""
        return decode_png(data, self.pixels, between)

    def encode(self, image: NDArray[np.uint8]) -> bytes:
        """See :func:`cspace.png.encode_png`."""
        return encode_png(image)

    def to_network(self, images: NDArray[np.uint8]) -> NDArray[np.float32]:
        """See :func:`cspace.worlds.planar.seeing.picture.to_network`."""
        return to_network(images)

    def from_network(self, pixels: NDArray[np.float32]) -> NDArray[np.uint8]:
        """See :func:`cspace.worlds.planar.seeing.picture.from_network`."""
        return from_network(pixels)
