"""Depth pictures as untrusted files: 16-bit PNG, and float32 as TIFF or ``.npy``."""

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


def read_depth(
    data: bytes, depth_scale_m: object = None, check_cancelled: CheckCancelled = lambda: None
) -> NDArray[np.uint16]:
    """An untrusted depth picture as (H, W) uint16, mm along the optical axis, 0 where there is no reading.

    ``data``: a 16-bit grey PNG; or float32, as a TIFF or a ``.npy`` file of shape (H, W), in which NaN,
    infinity and what is not above 0 are no reading. ``depth_scale_m``: metres per unit, of plain values; None
    for mm in a PNG and metres in a file of floats.
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
    except Exception as error:
        # All, for there is no list of what evaluating a header raises.
        raise _no_depth(".npy file", str(error)) from error
    check_size(*depth.shape)
    return depth


def _read_tiff(data: bytes) -> NDArray[np.float32]:
    try:
        _check_fields(data)
        with Image.open(io.BytesIO(data), formats=["TIFF"]) as picture:
            check_size(picture.height, picture.width)
            if picture.mode == "F":
                return np.array(picture)
            mode = picture.mode
    except ImageError:
        raise
    except Exception as error:
        # All, for there is no list of what a decoder raises for bytes from outside.
        raise _no_depth("file", str(error)) from error
    raise _no_depth("TIFF", f"a picture of mode {mode}")


def _check_fields(data: bytes) -> None:
    """Refuse what Pillow would read before it knows the size: 8 MiB can name 400 GB of values.

    Source: TIFF, revision 6.0, section 2.
    """
    order = _BYTE_ORDERS[data[:4]]
    (at,) = struct.unpack_from(f"{order}I", data, 4)
    (count,) = struct.unpack_from(f"{order}H", data, at)
    values = [struct.unpack_from(f"{order}I", data, at + 6 + 12 * field)[0] for field in range(count)]
    (following,) = struct.unpack_from(f"{order}I", data, at + 2 + 12 * count)
    if count > _MOST_FIELDS or max(values, default=0) > _MOST_VALUES or following:
        raise _no_depth(
            "TIFF", f"{count} fields of up to {max(values, default=0)} values, or several pictures"
        )


def _no_depth(kind: str, got: str) -> ImageError:
    return ImageError(
        f"the {kind} is no depth picture",
        expected="float32 of shape (H, W), metres along the optical axis, or mm as a 16-bit PNG",
        got=got[:200],
        remedy="write depth_m.astype(np.float32) by np.save, Pillow, OpenCV or tifffile",
    )
