"""The camera above the plane: untrusted PNG bytes to RGB arrays, and these to network input."""

from itertools import pairwise
from typing import Annotated, Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image
from pydantic import Field

from cspace.errors import ImageError, ScenarioError
from cspace.files import Record, open_png, validated
from cspace.world import CheckCancelled

MIN_SIDE = 16
MAX_SIDE = 2048
# Squares of places and lengths are numbers, too.
_FARTHEST_M = 1e6
Place = Annotated[float, Field(ge=-_FARTHEST_M, le=_FARTHEST_M)]
Length = Annotated[float, Field(gt=0.0, le=_FARTHEST_M)]
# Columns that are averaged at a time: a whole picture as floats would take 50 MB.
_BAND = 128


def decode_png(
    data: bytes, pixels: int = 48, check_cancelled: CheckCancelled = lambda: None
) -> NDArray[np.uint8]:
    """An untrusted PNG as (pixels, pixels, 3) uint8: over white, as RGB, resized by area averaging."""
    picture = open_png(data, _check)
    return _to_rgb(picture) if picture.width == pixels else _average(picture, pixels, check_cancelled)


def _check(picture: Image.Image) -> None:
    """By the header alone, so that no bomb is ever decoded."""
    width, height = picture.size
    if width != height or not MIN_SIDE <= width <= MAX_SIDE:
        raise ImageError(
            "the picture's size does not fit",
            expected=f"a square of {MIN_SIDE} to {MAX_SIDE} pixels a side",
            got=f"{width} x {height}",
        )
    if picture.mode.startswith("I"):
        raise ImageError("the picture has 16 bits a channel", expected="at most 8", got="16")


def _to_rgb(picture: Image.Image) -> NDArray[np.uint8]:
    if picture.mode in ("RGBA", "LA") or "transparency" in picture.info:
        rgba = picture.convert("RGBA")
        ground = Image.new("RGBA", rgba.size, (255, 255, 255, 255))
        picture = Image.alpha_composite(ground, rgba)
    return np.asarray(picture.convert("RGB"), dtype=np.uint8)


def _average(picture: Image.Image, pixels: int, check_cancelled: CheckCancelled) -> NDArray[np.uint8]:
    """Area averaging: every target pixel is the mean of the source area that it covers."""
    side = picture.width
    # (pixels, side) shares: how much of each source pixel a target pixel covers, rows summing to one.
    edges, cells = np.arange(pixels + 1) * (side / pixels), np.arange(side)
    covered = np.minimum(edges[1:, None], cells + 1) - np.maximum(edges[:-1, None], cells)
    weights = np.asarray(np.clip(covered, 0.0, None) * (pixels / side), dtype=np.float32)
    rows = np.empty((pixels, side, 3), dtype=np.float32)
    # In widths about equal: a narrow rest might round otherwise.
    count = -(-side // _BAND)
    for left, right in pairwise(side * index // count for index in range(count + 1)):
        band = _to_rgb(picture.crop((left, 0, right, side))).astype(np.float32)
        rows[:, left:right] = np.tensordot(weights, band, axes=(1, 0))
        check_cancelled()
    both = np.tensordot(weights, rows, axes=(1, 1)).transpose(1, 0, 2)
    return np.asarray(np.clip(np.floor(both + np.float32(0.5)), 0, 255), dtype=np.uint8)


@validated(ScenarioError)
class Camera(Record):
    """The part of the plane that the picture shows, y up, and its size in pixels (square)."""

    x_min_m: Place = -5.0
    x_max_m: Place = 5.0
    y_min_m: Place = -5.0
    y_max_m: Place = 5.0
    pixels: Annotated[int, Field(ge=MIN_SIDE, le=MAX_SIDE)] = 48

    @property
    def picture_shape(self) -> tuple[int, ...]:
        return (self.pixels, self.pixels, 3)

    @property
    def convention(self) -> dict[str, Any]:
        return {"pixels": self.pixels, "channels": "RGB", "range": [-1, 1]}

    @property
    def extent_m(self) -> tuple[float, float, float, float]:
        return (self.x_min_m, self.x_max_m, self.y_min_m, self.y_max_m)

    def to_network(self, images: NDArray[np.uint8]) -> NDArray[np.float32]:
        """(..., H, W, 3) uint8 to (..., 3, H, W) float32 in [-1, 1]."""
        scaled = images.astype(np.float32) / np.float32(127.5) - np.float32(1.0)
        return np.ascontiguousarray(np.moveaxis(scaled, -1, -3))
