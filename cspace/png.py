"""Untrusted PNG files chunk by chunk, before any decoder sees them, and how such files are written.

Source: W3C PNG, third edition, section 5.

What a decoder gets is a file of the chunks that pixels are made of, each looked at and its sum checked: a
header that comes twice, comments, profiles and metadata never reach it.
"""

import io
import struct
import zlib
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from cspace.errors import ImageError

# An encoder that writes 1 kB at a time fills 8 MiB with fewer.
MAX_CHUNKS = 10_000
_SIGNATURE = b"\x89PNG\r\n\x1a\n"
_HEADER_BYTES = 33
# Bit depths that a colour type may have.
_DEPTHS = {0: (1, 2, 4, 8, 16), 2: (8, 16), 3: (1, 2, 4, 8), 4: (8, 16), 6: (8, 16)}
_GREY, _COLOUR, _PALETTE = 0, 2, 3
_CLEAR_BYTES = {_GREY: 2, _COLOUR: 6}
_ANIMATION = {b"acTL", b"fcTL", b"fdAT"}
_USED = {b"PLTE", b"tRNS", b"IDAT", b"IEND"}
_ANCILLARY_BIT = 0x20


@dataclass(frozen=True, slots=True)
class PngHeader:
    """What a file's first chunk says.

    Args:
        width: in pixels.
        height: in pixels.
        depth: bits a sample.
        colour: type of its pixels: 0 grey, 2 RGB, 3 palette, 4 grey with alpha, 6 RGBA.
    """

    width: int
    height: int
    depth: int
    colour: int

    @property
    def pixels(self) -> int:
        """How many there are."""
        return self.width * self.height


def read_header(data: bytes) -> PngHeader:
    """The header of a file, of any size.

    Raises:
        ImageError: the file does not begin as a PNG does, or no picture can be as its header says.
    """
    if len(data) < _HEADER_BYTES or data[:16] != _SIGNATURE + b"\0\0\0\x0dIHDR":
        raise ImageError(
            "the picture is not a PNG", expected="a PNG file", got=f"{len(data)} bytes of something else"
        )
    width, height, depth, colour, compression, filtering, interlace = struct.unpack(">IIBBBBB", data[16:29])
    _check_sum(memoryview(data)[12:33])
    if depth not in _DEPTHS.get(colour, ()) or compression or filtering or interlace > 1:
        raise damaged(f"a header of depth {depth} and colour type {colour}, or methods, that do not exist")
    return PngHeader(width, height, depth, colour)


def canonical_png(data: bytes, header: PngHeader) -> bytes:
    """The same picture as a file of IHDR, PLTE, tRNS, IDAT and IEND alone; ``data`` itself where it is that.

    What comes after IEND is cut off.

    Args:
        data: the file.
        header: its header, from :func:`read_header`.

    Raises:
        ImageError: the file is cut or animated, its chunks are not those of a picture, one that is used does
            not have its sum, or there are more than :data:`MAX_CHUNKS`.
    """
    order, view = _Order(header), memoryview(data)
    kept, at = [view[:_HEADER_BYTES]], _HEADER_BYTES
    for _ in range(MAX_CHUNKS):
        if at + 12 > len(data):
            raise damaged("it ends without IEND")
        length, kind = struct.unpack_from(">I4s", data, at)
        end = at + 12 + length
        if end > len(data):
            raise damaged(f"it ends within the chunk {kind!r}")
        order.check(kind, length)
        if kind in _USED:
            _check_sum(view[at + 4 : end])
        if order.is_needed(kind):
            kept.append(view[at:end])
        if kind == b"IEND":
            # Without a copy of some MiB in the usual case.
            return data if sum(map(len, kept)) == len(data) else b"".join(kept)
        at = end
    raise damaged(f"more than {MAX_CHUNKS} chunks")


def damaged(got: str) -> ImageError:
    """The error for a file that no picture can be made of."""
    return ImageError("the picture is damaged", expected="a complete PNG file", got=got)


class _Order:
    """Which chunks may come where.

    Args:
        header: of the file.
    """

    def __init__(self, header: PngHeader) -> None:
        self._colour = header.colour
        self._seen: set[bytes] = set()
        self._last, self._entries = b"IHDR", 0

    def check(self, kind: bytes, length: int) -> None:
        """Take the next chunk's kind and the length of its data.

        Raises:
            ImageError: it may not stand here, or not in any picture.
        """
        if kind in _ANIMATION:
            raise ImageError("the picture is animated", expected="a single frame", remedy="send one frame")
        if kind in _USED:
            if not self._fits(kind, length):
                raise damaged(f"a chunk {kind!r} of {length} bytes that cannot stand there")
            self._seen.add(kind)
        elif not kind.isalpha() or not kind[0] & _ANCILLARY_BIT:
            raise damaged(f"a chunk {kind!r} that no picture needs")
        self._last = kind

    def is_needed(self, kind: bytes) -> bool:
        """Whether pixels depend on a chunk of this kind."""
        return kind in _USED and (kind != b"PLTE" or self._colour == _PALETTE)

    def _fits(self, kind: bytes, length: int) -> bool:
        seen = self._seen
        if kind == b"IDAT":
            coloured = self._colour != _PALETTE or b"PLTE" in seen
            return coloured and (b"IDAT" not in seen or self._last == b"IDAT")
        if kind == b"IEND":
            return b"IDAT" in seen and length == 0
        if kind in seen or b"IDAT" in seen:
            return False
        return self._fits_palette(length) if kind == b"PLTE" else self._fits_clear(length)

    def _fits_palette(self, length: int) -> bool:
        self._entries = length // 3
        return b"tRNS" not in self._seen and length % 3 == 0 and 1 <= self._entries <= 256

    def _fits_clear(self, length: int) -> bool:
        if self._colour == _PALETTE:
            return 1 <= length <= self._entries
        return length == _CLEAR_BYTES.get(self._colour)


def _check_sum(chunk: memoryview) -> None:
    """A chunk from its kind to its sum."""
    if zlib.crc32(chunk[:-4]) != int.from_bytes(chunk[-4:], "big"):
        raise damaged(f"a chunk {bytes(chunk[:4])!r} with a wrong sum")


def encode_png(image: NDArray[np.uint8]) -> bytes:
    """An RGB picture (H, W, 3) uint8 as PNG bytes."""
    buffer = io.BytesIO()
    Image.fromarray(np.ascontiguousarray(image, dtype=np.uint8)).save(buffer, format="PNG")
    return buffer.getvalue()
