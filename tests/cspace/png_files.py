"""Chunks of PNG files, to write some that no encoder would."""

import struct
import zlib

SIGNATURE = b"\x89PNG\r\n\x1a\n"


def chunk(kind: bytes, data: bytes = b"") -> bytes:
    """A chunk with its sum."""
    return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))


def header(width: int, height: int, depth: int = 8, colour: int = 2) -> bytes:
    """The chunk IHDR; a colour of 2 is RGB, of 0 grey."""
    return chunk(b"IHDR", struct.pack(">IIBBBBB", width, height, depth, colour, 0, 0, 0))


def file(*chunks: bytes) -> bytes:
    """The signature and chunks."""
    return b"".join((SIGNATURE, *chunks))
