"""PNG files that follow the format almost, from a seeded generator."""

import random
import zlib
from collections.abc import Callable

import numpy as np

from tests.cspace.png_files import KINDS, PALETTE, chunk, header, pixels, random_samples

SIGNATURE = b"\x89PNG\r\n\x1a\n"
SIDES = (0, 1, 15, 16, 20, 48, 2048, 2049, 9400, 2**31 - 1, 2**31, 2**32 - 1)
EXTRAS = (
    b"tRNS",
    b"PLTE",
    b"gAMA",
    b"iCCP",
    b"zTXt",
    b"iTXt",
    b"eXIf",
    b"acTL",
    b"fdAT",
    b"sBIT",
    b"CgBI",
    b"IHDR",
    b"\0\0\0\0",
)


def png(rng: random.Random) -> bytes:
    """A file, wrong in none to three ways."""
    chunks = _good(rng)
    for _ in range(rng.choice([0, 1, 1, 1, 2, 3])):
        chunks = rng.choice(_CHANGES)(rng, chunks)
    data = rng.choice([SIGNATURE] * 20 + [b"", b"\x89PNG"]) + b"".join(chunks)
    if data and rng.random() < 0.1:
        at = rng.randrange(len(data))
        data = data[:at] + rng.randbytes(1) + data[at + rng.choice([0, 1]) :]
    return data[: rng.randrange(len(data) + 1)] if rng.random() < 0.05 else data


def _good(rng: random.Random) -> list[bytes]:
    depth, colour = rng.choice(KINDS)
    side, interlace = rng.choice([16, 20, 48, 49]), rng.randrange(2)
    samples = random_samples(np.random.default_rng(rng.getrandbits(32)), side, depth, colour)
    palette = [chunk(b"PLTE", rng.randbytes(3 * 2**depth))] if colour == PALETTE else []
    return [
        header(side, side, depth, colour, interlace),
        *palette,
        pixels(samples, depth, interlace),
        chunk(b"IEND"),
    ]


def _twice(rng: random.Random, chunks: list[bytes]) -> list[bytes]:
    at = rng.randrange(len(chunks) or 1)
    return [*chunks[:at], *chunks[at : at + 1], *chunks[at:]]


def _shuffled(rng: random.Random, chunks: list[bytes]) -> list[bytes]:
    first = rng.choice([0, 1, 1, 1])
    return chunks[:first] + rng.sample(chunks[first:], len(chunks[first:]))


def _dropped(rng: random.Random, chunks: list[bytes]) -> list[bytes]:
    at = rng.randint(0, len(chunks))
    return chunks[:at] + chunks[at + 1 :]


def _other_header(rng: random.Random, chunks: list[bytes]) -> list[bytes]:
    side, depth = rng.choice(SIDES), rng.choice([0, 1, 2, 3, 4, 8, 16, 255])
    width = side if rng.random() < 0.8 else rng.choice(SIDES)
    made = header(width, side, depth, rng.choice([0, 1, 2, 3, 4, 5, 6, 7]), rng.choice([0, 0, 1, 2]))
    return [made, *chunks[1:]] if rng.random() < 0.7 else [*chunks[:1], made, *chunks[1:]]


def _extra(rng: random.Random, chunks: list[bytes]) -> list[bytes]:
    at = rng.randint(1, max(len(chunks), 1))
    contents = rng.choice(
        [b"", rng.randbytes(rng.choice([1, 2, 6, 9, 300])), b"k\0\0" + zlib.compress(bytes(2**20))]
    )
    return [
        *chunks[:at],
        *[chunk(rng.choice(EXTRAS), contents)] * rng.choice([1, 1, 2, 11_000 if len(contents) < 10 else 3]),
        *chunks[at:],
    ]


def _other_length(rng: random.Random, chunks: list[bytes]) -> list[bytes]:
    at = rng.randrange(len(chunks) or 1)
    length = rng.choice([0, 1, 12, 2**31 - 1, 2**31, 2**32 - 1]).to_bytes(4, "big")
    return [*chunks[:at], *[length + one[4:] for one in chunks[at : at + 1]], *chunks[at + 1 :]]


def _other_stream(rng: random.Random, chunks: list[bytes]) -> list[bytes]:
    return [_streamed(rng, one) if one[4:8] == b"IDAT" else one for one in chunks]


def _streamed(rng: random.Random, idat: bytes) -> bytes:
    data = idat[8:-4]
    at = rng.randrange(len(data) or 1)
    return b"".join(
        chunk(b"IDAT", part)
        for part in rng.choice(
            [
                [data[:at]],
                [data[:at] + rng.randbytes(2) + data[at:]],
                [zlib.compress(bytes(rng.choice([0, 100, 2**22])), 9)],
                [rng.randbytes(50)],
                [data[:at], b"", data[at:]],
                [data, data],
                [data + bytes(1000)],
            ]
        )
    )


_CHANGES: tuple[Callable[[random.Random, list[bytes]], list[bytes]], ...] = (
    _twice,
    _shuffled,
    _dropped,
    _other_header,
    _extra,
    _other_length,
    _other_stream,
)
