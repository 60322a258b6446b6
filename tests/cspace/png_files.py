"""PNG files written chunk by chunk, of every kind that there may be, and as no encoder would write them."""

import struct
import zlib

import numpy as np
from numpy.typing import NDArray

SIGNATURE = b"\x89PNG\r\n\x1a\n"
GREY, RGB, PALETTE, GREY_ALPHA, RGBA = 0, 2, 3, 4, 6
CHANNELS = {GREY: 1, RGB: 3, PALETTE: 1, GREY_ALPHA: 2, RGBA: 4}
KINDS = [(depth, GREY) for depth in (1, 2, 4, 8)] + [(depth, PALETTE) for depth in (1, 2, 4, 8)]
KINDS += [(8, RGB), (8, GREY_ALPHA), (8, RGBA)]
_WHOLE = ((0, 0, 1, 1),)
# First row, first column, row step and column step of Adam7's seven passes.
_PASSES = (
    (0, 0, 8, 8), (0, 4, 8, 8), (4, 0, 8, 4), (0, 2, 4, 4), (2, 0, 4, 2), (0, 1, 2, 2), (1, 0, 2, 1),
)  # fmt: skip


def chunk(kind: bytes, data: bytes = b"") -> bytes:
    """A chunk with its sum."""
    return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))


def header(width: int, height: int, depth: int = 8, colour: int = RGB, interlace: int = 0) -> bytes:
    """The chunk IHDR."""
    return chunk(b"IHDR", struct.pack(">IIBBBBB", width, height, depth, colour, 0, 0, interlace))


def pixels(samples: NDArray[np.uint8], depth: int, interlace: int = 0) -> bytes:
    """The chunk IDAT of samples (H, W, channels), each below 2^depth."""
    rows = []
    for top, left, down, right in _PASSES if interlace else _WHOLE:
        part = samples[top::down, left::right]
        if part.size:
            rows += [b"\0" + _packed(row, depth) for row in part.reshape(len(part), -1)]
    return chunk(b"IDAT", zlib.compress(b"".join(rows), 1))


def random_samples(rng: np.random.Generator, side: int, depth: int, colour: int) -> NDArray[np.uint8]:
    """Samples (side, side, channels)."""
    return rng.integers(0, 2**depth, (side, side, CHANNELS[colour]), dtype=np.uint8)


def file(*chunks: bytes) -> bytes:
    """The signature and chunks."""
    return b"".join((SIGNATURE, *chunks))


def _packed(row: NDArray[np.uint8], depth: int) -> bytes:
    bits = np.unpackbits(row[:, None], axis=1)[:, 8 - depth :]
    return np.packbits(bits.ravel()).tobytes()
