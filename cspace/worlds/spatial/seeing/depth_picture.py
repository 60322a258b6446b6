"""Depth pictures at the edge: untrusted 16-bit grey PNG bytes to mm along the optical axis, and back.

0 is no reading. Nothing here averages: a mean over a depth edge is a surface that is not there.
"""

import io
import struct
import zlib

import numpy as np
from numpy.typing import ArrayLike, NDArray
from PIL import Image

from cspace.errors import ImageError
from cspace.png import PngHeader, canonical_png, damaged, read_header
from cspace.world import Between
from cspace.worlds.spatial.seeing.camera import MAX_SIDE, MIN_SIDE

# No depth camera for arms reads nearer or farther. What a file says beyond is no reading: 65535, as many
# drivers write it, is not a wall 65 m away behind free space.
NEAREST_MM, FARTHEST_MM = 20, 10_000
DEPTH_SCALE_M = 0.001
MIN_SCALE_M, MAX_SCALE_M = 1e-6, 1.0
_GREY = 0
_MAX_MM = 65_535
_HEADER_BYTES = 33
_INTERLACE_AT = 28
# First row, first column, row step and column step of each pass of a file, and of one that is interlaced.
_WHOLE = ((0, 0, 1, 1),)
_PASSES = (
    (0, 0, 8, 8), (0, 4, 8, 8), (4, 0, 8, 4), (0, 2, 4, 4), (2, 0, 4, 2), (0, 1, 2, 2), (1, 0, 2, 1),
)  # fmt: skip


def decode_depth(data: bytes, between: Between = lambda: None) -> NDArray[np.uint16]:
    """An untrusted PNG as (H, W) uint16, mm along the optical axis, 0 where there is no reading.

    Args:
        data: the file's bytes.
        between: called between the parts of the work; what it raises passes through.

    Raises:
        ImageError: not a PNG, not 16-bit grey, animated, below 16 or above 2048 pixels on a side, or damaged.
    """
    header = read_header(data)
    _check(header)
    content = canonical_png(data, header)
    _check_length(content, header)
    between()
    try:
        with Image.open(io.BytesIO(content), formats=["PNG"]) as picture:
            depth = np.array(picture)
    except Exception as error:
        # All, for there is no list of what a decoder raises for bytes from outside.
        raise damaged(_reason(error)) from error
    if depth.shape != (header.height, header.width):
        raise damaged(f"pixels of shape {depth.shape}")
    return depth.astype(np.uint16)


def encode_depth(depth_mm: NDArray[np.uint16]) -> bytes:
    """A depth picture (H, W) uint16 mm as PNG bytes.

    Raises:
        ImageError: it is no such array.
    """
    depth = np.asarray(depth_mm)
    if depth.ndim != 2 or depth.dtype != np.uint16 or not depth.size:
        raise ImageError(
            "the depth picture is none", expected="(H, W) uint16", got=f"{depth.shape} {depth.dtype}"
        )
    buffer = io.BytesIO()
    Image.fromarray(np.ascontiguousarray(depth, dtype="<u2")).save(buffer, format="PNG")
    return buffer.getvalue()


def to_mm(depth_m: ArrayLike) -> NDArray[np.uint16]:
    """Depths (...) m as uint16 mm, rounded; 0 where that is no whole number from 1 to 65535."""
    depth = np.asarray(depth_m, dtype=np.float64)
    with np.errstate(invalid="ignore", over="ignore"):
        rounded = np.floor(depth * 1000.0 + 0.5)
        held = (rounded >= 1.0) & (rounded <= _MAX_MM)
    return np.where(held, rounded, 0.0).astype(np.uint16)


def to_m(depth_mm: NDArray[np.uint16]) -> NDArray[np.float32]:
    """Depths (...) uint16 mm as float32 m; 0 stays 0."""
    return np.asarray(depth_mm.astype(np.float32) / np.float32(1000.0))


def scaled_mm(units: NDArray[np.uint16], depth_scale_m: float) -> NDArray[np.uint16]:
    """A depth picture (H, W) of another unit in mm, rounded; at most 65535, and 0 stays 0.

    Args:
        units: (H, W) uint16.
        depth_scale_m: metres that one unit stands for.

    Raises:
        ImageError: the scale is not a finite number from 1e-6 to 1.
    """
    if not MIN_SCALE_M <= depth_scale_m <= MAX_SCALE_M:
        raise ImageError(
            "depth_scale_m does not fit",
            expected=f"metres per unit of the depth pictures, {MIN_SCALE_M:g} to {MAX_SCALE_M:g}",
            got=repr(depth_scale_m)[:100],
            remedy="send 0.001 for millimetres, 0.0001 for tenths, 0.0002 for TUM RGB-D",
        )
    if depth_scale_m == DEPTH_SCALE_M:
        return units
    scaled = np.floor(units * (1000.0 * depth_scale_m) + 0.5)
    return np.asarray(np.minimum(scaled, _MAX_MM), dtype=np.uint16)


def in_range(depth_mm: NDArray[np.uint16]) -> NDArray[np.bool_]:
    """Which pixels (...) hold a distance that a depth camera can read."""
    return np.asarray((depth_mm >= NEAREST_MM) & (depth_mm <= FARTHEST_MM))


def resize_depth(depth: NDArray[np.generic], height: int, width: int) -> NDArray[np.generic]:
    """A depth picture (H, W) in another size, (height, width), of the same type.

    Every pixel is the nearest surface read in the cell that it covers, 0 where nothing is read in it; along
    an axis that grows, pixels are repeated. The camera of the result is :meth:`DepthCamera.resized`.

    Raises:
        ImageError: a side is below 1, or the picture is empty.
    """
    if depth.ndim != 2 or not depth.size or height < 1 or width < 1:
        raise ImageError(
            "the depth picture cannot be resized",
            expected="a picture and a size of at least 1 x 1",
            got=f"{depth.shape} to {height} x {width}",
        )
    if depth.dtype.kind == "u":
        # 0 wraps round to the largest number, and back again: one pass for what was read and what was not.
        one = np.ones((), dtype=depth.dtype)
        return np.asarray(_least(_least(depth - one, 0, height), 1, width) + one)
    filled = np.where(depth > 0, depth, np.asarray(np.inf, dtype=depth.dtype))  # type: ignore[operator]
    least = _least(_least(filled, 0, height), 1, width)
    return np.where(np.isinf(least), np.zeros((), dtype=depth.dtype), least)


def _least(values: NDArray[np.generic], axis: int, size: int) -> NDArray[np.generic]:
    """The least value of each of ``size`` cells along an axis; the nearest value where there are more."""
    source = values.shape[axis]
    if size >= source:
        return np.asarray(np.take(values, (2 * np.arange(size) + 1) * source // (2 * size), axis=axis))
    return np.asarray(np.minimum.reduceat(values, np.arange(size) * source // size, axis=axis))


def _check(header: PngHeader) -> None:
    """By the header alone, so that no bomb is ever decoded."""
    if not (MIN_SIDE <= header.width <= MAX_SIDE and MIN_SIDE <= header.height <= MAX_SIDE):
        raise ImageError(
            "the depth picture's size is out of range",
            expected=f"{MIN_SIDE} to {MAX_SIDE} pixels a side",
            got=f"{header.width} x {header.height}",
        )
    if header.colour != _GREY or header.depth != 16:
        kinds = {0: "grey", 2: "RGB", 3: "palette", 4: "grey with alpha", 6: "RGBA"}
        raise ImageError(
            "the picture is no depth picture",
            expected="16-bit grey, mm along the optical axis, 0 = no reading",
            got=f"{header.depth}-bit {kinds[header.colour]}",
        )


def _check_length(content: bytes, header: PngHeader) -> None:
    """Refuse pixels that end early: a decoder would take the rest for no reading, and say nothing."""
    passes = _PASSES if content[_INTERLACE_AT] else _WHOLE
    shapes = (
        (-(-(header.height - top) // down), -(-(header.width - left) // right))
        for top, left, down, right in passes
    )
    length = sum(rows * (1 + 2 * columns) for rows, columns in shapes)
    parts, at = [], _HEADER_BYTES
    while at < len(content):
        size, kind = struct.unpack_from(">I4s", content, at)
        if kind == b"IDAT":
            parts.append(memoryview(content)[at + 8 : at + 8 + size])
        at += 12 + size
    try:
        found = len(zlib.decompressobj().decompress(b"".join(parts), length))
    except zlib.error as error:
        raise damaged(_reason(error)) from error
    if found < length:
        raise damaged("pixels that end early")


def _reason(error: Exception) -> str:
    # Some messages of Pillow hold an object's address, which is nobody's business.
    text = str(error)
    return type(error).__name__ if not text or "0x" in text else text[:200]
