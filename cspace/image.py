"""Pictures at the edge: untrusted PNG bytes to RGB arrays, RGB arrays to PNG and to network input.

Drawing is in :mod:`cspace.render`, which needs numba; this module does not, so that a server can do without.
"""

import io
import struct
import warnings
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image, UnidentifiedImageError

from cspace.errors import ImageError

MIN_SIDE = 16
MAX_SIDE = 2048
_SIGNATURE = b"\x89PNG\r\n\x1a\n"
_MODES = {"RGB", "RGBA", "L", "LA", "P", "1"}


def encode_png(image: NDArray[np.uint8]) -> bytes:
    """An RGB picture (H, W, 3) uint8 as PNG bytes."""
    buffer = io.BytesIO()
    Image.fromarray(np.ascontiguousarray(image, dtype=np.uint8)).save(buffer, format="PNG")
    return buffer.getvalue()


def decode_png(data: bytes, pixels: int = 48) -> NDArray[np.uint8]:
    """An untrusted PNG as (pixels, pixels, 3) uint8.

    RGB as it is, RGBA over white, grey and palette as RGB; resized by area averaging.

    Args:
        data: the file's bytes.
        pixels: side of the result.

    Raises:
        ImageError: not a PNG, 16-bit, animated, not square, below 16 or above 2048 pixels, or damaged.
    """
    side, depth = _header(data)
    if depth == 16:
        raise ImageError("the picture has 16 bits a channel", expected="at most 8", got="16")
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            with Image.open(io.BytesIO(data), formats=["PNG"]) as picture:
                if getattr(picture, "is_animated", False) or "default_image" in picture.info:
                    raise ImageError(
                        "the picture is animated", expected="a single frame", remedy="send one frame"
                    )
                rgb = _to_rgb(picture)
    except (
        OSError,
        SyntaxError,
        ValueError,
        EOFError,
        struct.error,
        Warning,
        UnidentifiedImageError,
    ) as error:
        if isinstance(error, ImageError):
            raise
        raise ImageError("the picture is damaged", expected="a complete PNG file", got=str(error)) from error
    return rgb if side == pixels else _average(rgb, pixels)


def to_network(images: NDArray[np.uint8]) -> NDArray[np.float32]:
    """(..., H, W, 3) uint8 to (..., 3, H, W) float32 in [-1, 1]."""
    scaled = images.astype(np.float32) / np.float32(127.5) - np.float32(1.0)
    return np.ascontiguousarray(np.moveaxis(scaled, -1, -3))


def _header(data: bytes) -> tuple[int, int]:
    """Side and bit depth from the header alone, so that no bomb is ever decoded."""
    if len(data) < 33 or not data.startswith(_SIGNATURE) or data[12:16] != b"IHDR":
        raise ImageError(
            "the picture is not a PNG", expected="a PNG file", got=f"{len(data)} bytes of something else"
        )
    width, height, depth = struct.unpack(">IIB", data[16:25])
    if width != height:
        raise ImageError("the picture is not square", expected="width = height", got=f"{width} x {height}")
    if not MIN_SIDE <= width <= MAX_SIDE:
        raise ImageError(
            "the picture's size is out of range",
            expected=f"{MIN_SIDE} to {MAX_SIDE} pixels a side",
            got=f"{width} x {height}",
        )
    return int(width), int(depth)


def _to_rgb(picture: Image.Image) -> NDArray[np.uint8]:
    if picture.mode not in _MODES:
        raise ImageError(
            "the picture's mode is not supported", expected=", ".join(sorted(_MODES)), got=picture.mode
        )
    if picture.mode in ("RGBA", "LA") or "transparency" in picture.info:
        rgba = picture.convert("RGBA")
        ground = Image.new("RGBA", rgba.size, (255, 255, 255, 255))
        picture = Image.alpha_composite(ground, rgba)
    return np.asarray(picture.convert("RGB"), dtype=np.uint8)


def _average(rgb: NDArray[np.uint8], pixels: int) -> NDArray[np.uint8]:
    """Area averaging: every target pixel is the mean of the source area that it covers."""
    weights = _overlap(rgb.shape[0], pixels)
    rows = np.tensordot(weights, rgb.astype(np.float32), axes=(1, 0))
    both: NDArray[np.float32] = np.tensordot(weights, rows, axes=(1, 1)).transpose(1, 0, 2)
    rounded = np.clip(np.floor(both + np.float32(0.5)), 0, 255)
    return np.asarray(rounded, dtype=np.uint8)


def _overlap(source: int, target: int) -> NDArray[Any]:
    """(target, source) shares: how much of each source pixel a target pixel covers, rows summing to one."""
    edges = np.arange(target + 1) * (source / target)
    left, right = edges[:-1, None], edges[1:, None]
    cells = np.arange(source)[None, :]
    shares = np.clip(np.minimum(right, cells + 1) - np.maximum(left, cells), 0.0, None)
    return np.asarray(shares * (target / source), dtype=np.float32)
