"""A scene's picture, as it is sent: a file, pixels, or what depth cameras saw."""

import io
import struct
import zlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from cspace_client.errors import SamplerError
from cspace_client.known import Known, as_json

File = tuple[str, bytes, str]
"""Name, content and media type."""

_PNG, _NPY, _STL = "image/png", "application/x-npy", "model/stl"
_GREY, _COLOUR = 0, 2
_MAX_PICTURES = 4


@dataclass(frozen=True, slots=True, eq=False)
class DepthPictures:
    """One scene as one to four depth cameras saw it, nothing but the robot having moved between.

    Args:
        pictures: depths along the optical axis: uint16 (h, w) of mm, 0 without a reading; float32 (h, w) of
            metres, NaN or infinity without one; or files of such pictures (PNG; TIFF or ``.npy``).
        cameras: ``fx``, ``fy``, ``cx``, ``cy`` and ``pose`` of each, or ``camera_info`` and ``pose``, as the
            API has them; with ``link`` where the pose is in that frame of the robot, and ``stamp_s``.
        state: (d,) rad, where the robot was; None where it is in no picture; or a list with one or the other
            for each picture.
        depth_scale_m: metres per unit of the pictures where that is another: 0.0001 for tenths of mm, 0.0002
            for TUM RGB-D; None for mm as whole numbers and metres as floats.
        max_age_s: pictures that are older by the server's clock are refused, and those without ``stamp_s``;
            None takes all.
        known: of the scene beside the pictures; None without anything.

    Raises:
        SamplerError: there are more or fewer cameras than pictures, or more than four.
    """

    pictures: Sequence[bytes | NDArray[np.uint16] | NDArray[np.float32]]
    cameras: Sequence[Mapping[str, Any]]
    state: ArrayLike | Sequence[ArrayLike | None] | None = None
    depth_scale_m: float | None = None
    max_age_s: float | None = None
    known: Known | None = None

    def __post_init__(self) -> None:
        if not 1 <= len(self.pictures) <= _MAX_PICTURES or len(self.pictures) != len(self.cameras):
            raise SamplerError(
                "the depth pictures do not fit",
                expected=f"1 to {_MAX_PICTURES} pictures and a camera each, in the same order",
                got=f"{len(self.pictures)} pictures, {len(self.cameras)} cameras",
            )


@dataclass(frozen=True, slots=True, eq=False)
class PlanarPicture:
    """A picture of a plane with what is known of the scene beside it.

    Args:
        picture: its file, or uint8 (P, P, 3).
        known: discs, as its ``scene``.
    """

    picture: bytes | NDArray[np.uint8]
    known: Known


Picture = bytes | NDArray[np.uint8] | PlanarPicture | DepthPictures
"""A picture's file, uint8 (P, P, 3), one of these with known discs, or what depth cameras saw."""


@dataclass(frozen=True, slots=True, eq=False)
class Shown:
    """A picture as a form holds it.

    Args:
        files: of the field ``image``, one or more.
        fields: cameras, the robot's state, the unit, the largest age and what is known, where it has any.
        meshes: files of the field ``mesh``.
    """

    files: tuple[File, ...]
    fields: Mapping[str, Any]
    meshes: tuple[File, ...] = ()


def shown(picture: Picture) -> Shown:
    """A picture as it is sent.

    Raises:
        SamplerError: it is none that can be.
    """
    if not isinstance(picture, DepthPictures | PlanarPicture):
        return Shown((_file(picture),), {})
    parts = picture.pictures if isinstance(picture, DepthPictures) else [picture.picture]
    meshes = () if picture.known is None else picture.known.meshes.items()
    files = tuple(_file(part) for part in parts)
    return Shown(files, _fields(picture), tuple((name, data, _STL) for name, data in meshes))


def _file(part: bytes | NDArray[Any]) -> File:
    if isinstance(part, np.ndarray) and part.dtype.type is np.float32 and part.ndim == 2:
        file = io.BytesIO()
        np.save(file, part.astype("<f4"), allow_pickle=False)
        return "depth.npy", file.getvalue(), _NPY
    return "scenario.png", part if isinstance(part, bytes) else encode_png(part), _PNG


def _fields(picture: DepthPictures | PlanarPicture) -> dict[str, Any]:
    fields = {} if picture.known is None else picture.known.fields
    fields = {name: as_json(name, value) for name, value in fields.items()}
    if isinstance(picture, DepthPictures):
        fields["camera"] = [as_json("camera", camera) for camera in picture.cameras]
        for name in ("state", "depth_scale_m", "max_age_s"):
            if (value := getattr(picture, name)) is not None:
                fields[name] = as_json(name, value)
    return fields


def encode_png(image: NDArray[Any]) -> bytes:
    """Pixels as a PNG file: uint8 (H, W, 3) in colour, uint16 (H, W) in grey.

    Raises:
        SamplerError: they are neither.
    """
    pixels = np.asarray(image)
    colour = pixels.dtype.type is np.uint8 and pixels.ndim == 3 and pixels.shape[2] == 3
    grey = pixels.dtype.type is np.uint16 and pixels.ndim == 2
    if not (colour or grey) or pixels.size == 0:
        raise SamplerError(
            "the picture can not be sent",
            expected="a file, uint8 (P, P, 3), or uint16 (h, w) in mm or float32 in m of a depth camera",
            got=f"{pixels.dtype} {pixels.shape}"[:200],
        )
    height, width = pixels.shape[:2]
    rows = pixels.reshape(height, -1).astype(">u2" if grey else np.uint8).view(np.uint8)
    # Every row begins with the number of its filter: none.
    data = np.pad(rows, ((0, 0), (1, 0))).tobytes()
    header = struct.pack(">IIBBBBB", width, height, 16 if grey else 8, _GREY if grey else _COLOUR, 0, 0, 0)
    parts = ((b"IHDR", header), (b"IDAT", zlib.compress(data, 1)), (b"IEND", b""))
    return b"\x89PNG\r\n\x1a\n" + b"".join(_chunk(kind, part) for kind, part in parts)


def _chunk(kind: bytes, data: bytes) -> bytes:
    return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))
