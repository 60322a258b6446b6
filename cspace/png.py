"""Untrusted PNG files chunk by chunk, before any decoder sees them, and how such files are written.

Source: W3C PNG, third edition, section 5.

What a decoder gets is a file of the chunks that pixels are made of, each looked at and its sum checked: a
header that comes twice, comments, profiles and metadata never reach it.
"""

import io
import re
import struct
import zlib
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
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
# A file's chunks behind its header, a letter each: palette, transparency, pixels, end, and others, which need
# not be known.
_LETTERS = {b"PLTE": "P", b"tRNS": "T", b"IDAT": "D", b"IEND": "E"}
_ORDER = re.compile("o*(Po*)?(To*)?D+o*E")


@dataclass(frozen=True, slots=True)
class PngHeader:
    """What a file's first chunk says.

    Args:
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
    """The header of a file, of any size."""
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
    """
    view, at = memoryview(data), _HEADER_BYTES
    kept, lengths = [view[:_HEADER_BYTES]], {}
    letters: list[str] = []
    while letters[-1:] != ["E"]:
        length, kind = struct.unpack_from(">I4s", data, at) if at + 12 <= len(data) else (0, b"")
        end = at + 12 + length
        if not kind or end > len(data) or len(letters) == MAX_CHUNKS:
            raise damaged(f"it ends without IEND, within a chunk {kind!r}, or after {MAX_CHUNKS} chunks")
        if kind in _ANIMATION:
            raise ImageError("the picture is animated", expected="a single frame", remedy="send one frame")
        if kind in _LETTERS:
            _check_sum(view[at + 4 : end])
            lengths[kind] = length
        elif not kind.isalpha() or not kind[:1].islower():
            raise damaged(f"a chunk {kind!r} that no picture needs")
        if kind in _LETTERS and (kind != b"PLTE" or header.colour == _PALETTE):
            kept.append(view[at:end])
        letters.append(_LETTERS.get(kind, "o"))
        at = end
    if _ORDER.fullmatch("".join(letters)) is None or not _have_sizes(lengths, header.colour):
        raise damaged("chunks that cannot stand together")
    # Without a copy of some MiB in the usual case.
    return data if sum(map(len, kept)) == len(data) else b"".join(kept)


@contextmanager
def opened(content: bytes) -> Iterator[Image.Image]:
    """A canonical file in Pillow's decoder."""
    try:
        with Image.open(io.BytesIO(content), formats=["PNG"]) as picture:
            yield picture
    except Exception as error:
        # All, for there is no list of what a decoder raises for bytes from outside. Some of Pillow's messages
        # hold an object's address, which is nobody's business.
        text = str(error)
        raise damaged(type(error).__name__ if not text or "0x" in text else text[:200]) from error


def damaged(got: str) -> ImageError:
    """The error for a file that no picture can be made of."""
    return ImageError("the picture is damaged", expected="a complete PNG file", got=got)


def _have_sizes(lengths: Mapping[bytes, int], colour: int) -> bool:
    """Whether palette, transparency and end are as long as they can be for a colour type."""
    entries, rest = divmod(lengths.get(b"PLTE", 0), 3)
    palette = b"PLTE" not in lengths or (rest == 0 and 1 <= entries <= 256)
    clear = lengths.get(b"tRNS")
    if colour == _PALETTE:
        fits = entries > 0 and (clear is None or 1 <= clear <= entries)
    else:
        fits = clear is None or clear == _CLEAR_BYTES.get(colour)
    return palette and fits and lengths[b"IEND"] == 0


def _check_sum(chunk: memoryview) -> None:
    """A chunk from its kind to its sum."""
    if zlib.crc32(chunk[:-4]) != int.from_bytes(chunk[-4:], "big"):
        raise damaged(f"a chunk {bytes(chunk[:4])!r} with a wrong sum")


def encode_png(image: NDArray[np.uint8]) -> bytes:
    """An RGB picture (H, W, 3) uint8 as PNG bytes."""
    buffer = io.BytesIO()
    Image.fromarray(np.ascontiguousarray(image, dtype=np.uint8)).save(buffer, format="PNG")
    return buffer.getvalue()
