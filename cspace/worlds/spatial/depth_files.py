"""Depth pictures as untrusted files of any kind that is taken: 16-bit PNG, and float32 as TIFF or ``.npy``.

Source of the TIFF's fields: TIFF, revision 6.0, section 2.

Pillow reads a TIFF's fields and follows its links before it knows the size: 8 MiB can name 400 GB of values.
The one directory of a file is therefore checked here first.
"""

import io
import struct

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from cspace.errors import ImageError
from cspace.files import read_npy
from cspace.world import CheckCancelled
from cspace.worlds.spatial.camera import MAX_MM, check_scale, check_size, decode_depth

METRES = 1.0
_PNG, _NPY = b"\x89PNG", b"\x93NUMPY"
_BYTE_ORDERS = {b"II*\0": "<", b"MM\0*": ">"}
_MOST_FIELDS, _MOST_VALUES = 64, 8192
_SHORT, _LONG = 3, 4
_WIDTH, _HEIGHT, _BITS, _COMPRESSION, _OFFSETS, _ORIENTATION, _SAMPLES, _ROWS, _STRIP_BYTES, _FORMAT = (
    256, 257, 258, 259, 273, 274, 277, 278, 279, 339,
)  # fmt: skip
# Uncompressed, LZW as OpenCV writes it, and both numbers of deflate.
_COMPRESSIONS = ((1,), (5,), (8,), (32946,))
# Tiles, and links to further directories.
_REFUSED_FIELDS = {322, 323, 324, 325, 330, 34665, 34853, 40965}


def read_depth(
    data: bytes, depth_scale_m: object = None, check_cancelled: CheckCancelled = lambda: None
) -> NDArray[np.uint16]:
    """An untrusted depth picture as (H, W) uint16, mm along the optical axis, 0 where there is no reading.

    Args:
        data: a 16-bit grey PNG; or float32, as a TIFF or a ``.npy`` file of shape (H, W), in which NaN,
            infinity and what is not above 0 are no reading.
        depth_scale_m: metres per unit, of plain values; None for mm in a PNG and metres in a file of floats.
    """
    if data.startswith(_PNG):
        return in_mm(decode_depth(data, check_cancelled), depth_scale_m)
    depth = _read_npy(data) if data.startswith(_NPY) else _read_tiff(data)
    check_cancelled()
    return rounded_mm(depth, METRES if depth_scale_m is None else _read_scale(depth_scale_m))


def rounded_mm(depth: NDArray[np.float32] | NDArray[np.uint16], depth_scale_m: float) -> NDArray[np.uint16]:
    """Depths (...) in a unit of ``depth_scale_m`` as uint16 mm; 0 for NaN, infinity and what is below 0.5 mm.

    What is farther than 16 bits can tell stays a reading that is out of range, so that a wrong unit shows.
    """
    with np.errstate(invalid="ignore", over="ignore"):
        scaled = np.floor(depth.astype(np.float64) * (1000.0 * depth_scale_m) + 0.5)
    read = (scaled >= 1.0) & np.isfinite(scaled)
    return np.where(read, np.minimum(scaled, MAX_MM), 0.0).astype(np.uint16)


def in_mm(units: NDArray[np.uint16], depth_scale_m: object) -> NDArray[np.uint16]:
    """A depth picture (H, W) in mm; without a scale, a plain value, it is in mm already."""
    if depth_scale_m is None:
        return units
    return rounded_mm(units, _read_scale(depth_scale_m))


def _read_scale(depth_scale_m: object) -> float:
    scale = read_number(depth_scale_m, "depth_scale_m")
    check_scale(scale)
    return scale


def read_number(value: object, name: str) -> float:
    """A number of plain values."""
    if type(value) not in (int, float):
        raise ImageError(f"{name} does not fit", expected="a finite number", got=repr(value)[:200])
    return value  # type: ignore[return-value] # one of the two


def _read_npy(data: bytes) -> NDArray[np.float32]:
    try:
        depth = read_npy(data, ("<f4",), 2)
    except ValueError as error:
        raise ImageError(
            "the .npy file is no depth picture",
            expected="float32 of shape (H, W), metres along the optical axis",
            got=str(error),
            remedy="write it by np.save(file, depth_m.astype(np.float32)), or send mm as a 16-bit PNG",
        ) from error
    check_size(*depth.shape)
    return depth


def _read_tiff(data: bytes) -> NDArray[np.float32]:
    shape = _tiff_shape(data)
    try:
        with Image.open(io.BytesIO(data), formats=["TIFF"]) as picture:
            depth = np.array(picture) if picture.mode == "F" and picture.size == shape[::-1] else None
    except Exception as error:
        # All, for there is no list of what a decoder raises for bytes from outside.
        raise _damaged_tiff(type(error).__name__) from error
    if depth is None or depth.shape != shape or depth.dtype != np.float32:
        raise _damaged_tiff("other pixels than its fields name")
    return depth


def _tiff_shape(data: bytes) -> tuple[int, int]:
    """(H, W) by the fields of a TIFF's only directory, all of which are checked."""
    order = _BYTE_ORDERS.get(data[:4])
    if order is None:
        raise ImageError(
            "the depth picture is of an unknown kind",
            expected="a 16-bit grey PNG in mm, or float32 metres as a TIFF or .npy file",
            got=f"{len(data)} bytes of something else",
        )
    try:
        fields, following = _fields(data, order)
    except struct.error as error:
        raise _damaged_tiff("fields that end early") from error
    bits, samples, form, upright, packing = (
        fields.get(tag, (1,)) for tag in (_BITS, _SAMPLES, _FORMAT, _ORIENTATION, _COMPRESSION)
    )
    if (
        (bits, samples, form, upright) != ((32,), (1,), (3,), (1,))
        or following
        or packing not in _COMPRESSIONS
    ):
        raise _other_tiff(
            f"samples {samples} of {bits} bits, sample format {form}, orientation {upright}, "
            f"compression {packing}"[:200]
            + (", and further pictures" if following else "")
        )
    if refused := sorted(_REFUSED_FIELDS & fields.keys()):
        raise _other_tiff(f"tiles or links to other directories: fields {refused}")
    height, width = (fields.get(tag, (0,))[-1] for tag in (_HEIGHT, _WIDTH))
    check_size(height, width)
    rows = fields.get(_ROWS, (height,))[-1]
    strips = -(-height // rows) if rows else 0
    sizes = fields.get(_STRIP_BYTES, ())
    # A missing strip would be no reading, and nobody would say so; each byte is in one strip.
    if not strips == len(fields.get(_OFFSETS, ())) == len(sizes) or sum(sizes) > len(data):
        raise _damaged_tiff(f"strips that are not all of {height} rows, or longer than the file")
    return height, width


def _fields(data: bytes, order: str) -> tuple[dict[int, tuple[int, ...]], int]:
    """The whole numbers of each field, 0 for others; and where a next directory is, or 0."""
    (at,) = struct.unpack_from(f"{order}I", data, 4)
    (count,) = struct.unpack_from(f"{order}H", data, at)
    found: dict[int, tuple[int, ...]] = {}
    for place in range(at + 2, at + 2 + 12 * count, 12):
        tag, kind, values = struct.unpack_from(f"{order}HHI", data, place)
        if len(found) == _MOST_FIELDS or values > _MOST_VALUES or tag in found or (not values):
            raise _other_tiff(f"{count} fields, {values} values in field {tag}, or that field twice")
        form, size = {_SHORT: ("H", 2), _LONG: ("I", 4)}.get(kind, ("", 0))
        if values * size > 4:
            (start,) = struct.unpack_from(f"{order}I", data, place + 8)
        else:
            start = place + 8
        found[tag] = struct.unpack_from(f"{order}{values}{form}", data, start) if form else (0,)
    (following,) = struct.unpack_from(f"{order}I", data, at + 2 + 12 * count)
    return found, following


def _other_tiff(got: str) -> ImageError:
    return ImageError(
        "the TIFF is no depth picture",
        expected="one upright picture of one 32-bit float sample (sample format 3), in strips without "
        "compression, or with LZW or deflate",
        got=got,
        remedy="write depth_m.astype(np.float32) by Pillow, OpenCV or tifffile, or as .npy",
    )


def _damaged_tiff(got: str) -> ImageError:
    return ImageError("the picture is damaged", expected="a complete TIFF file", got=got)
