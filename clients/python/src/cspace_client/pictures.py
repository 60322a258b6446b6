"""A scene's picture as it is sent: a file, pixels, or what depth cameras saw."""

import io
import json
import struct
import zlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from cspace_client.errors import SamplerError
from cspace_client.known import Known
from cspace_client.wire import FORM_REPEATED, FORM_TEXTS, MAX_PICTURES, Request, ViewFields

Part = tuple[str, tuple[str, bytes, str]]
"""A file of a form: its field; its name, content and media type."""

_PNG, NPY, _STL = "image/png", "application/x-npy", "model/stl"
_GREY, _COLOUR = 0, 2


@dataclass(frozen=True, slots=True, eq=False)
class DepthPictures:
    """One scene as one to four depth cameras saw it, nothing but the robot having moved between.

    Args:
        pictures: depths along the optical axis: uint16 (h, w) of mm, 0 without a reading; float32 (h, w) of
            metres, NaN or infinity without one; or files of such pictures (PNG; TIFF or ``.npy``).
        cameras: one for each, as :class:`cspace_client.wire.Camera` has the fields.
        state: (d,) rad, where the robot was; None where it is in no picture; or a list of one for each.
        depth_scale_m: metres per unit of the pictures; None for mm as whole numbers and metres as floats.
        max_age_s: pictures that are older by the server's clock are refused, and those without ``stamp_s``.
        check_pose: refuse a state or pose by which the arm is clearly not where the pictures show it.
    """

    pictures: Sequence[bytes | NDArray[np.uint16] | NDArray[np.float32]]
    cameras: Sequence[Mapping[str, Any]]
    state: ArrayLike | Sequence[ArrayLike | None] | None = None
    depth_scale_m: float | None = None
    max_age_s: float | None = None
    known: Known | None = None
    check_pose: bool = True

    def __post_init__(self) -> None:
        if not 1 <= len(self.pictures) <= MAX_PICTURES or len(self.pictures) != len(self.cameras):
            raise SamplerError(
                "the depth pictures do not fit",
                expected=f"1 to {MAX_PICTURES} pictures and a camera each, in the same order",
                got=f"{len(self.pictures)} pictures, {len(self.cameras)} cameras",
            )


@dataclass(frozen=True, slots=True, eq=False)
class PlanarPicture:
    """A picture of a plane, a file or uint8 (P, P, 3), with known discs beside it."""

    picture: bytes | NDArray[np.uint8]
    known: Known


Picture = bytes | NDArray[np.uint8] | PlanarPicture | DepthPictures
"""A picture's file, uint8 (P, P, 3), one of these with known discs, or what depth cameras saw."""


def shown(picture: Picture) -> tuple[list[Part], ViewFields]:
    """A picture as a form holds it: the files of ``image`` and ``mesh``, and the other fields."""
    if not isinstance(picture, DepthPictures | PlanarPicture):
        return [_file(picture)], ViewFields()
    known = picture.known or Known()
    meshes: list[Part] = [("mesh", (name, data, _STL)) for name, data in known.meshes.items()]
    values: dict[str, Any] = known.fields
    if isinstance(picture, PlanarPicture):
        return [_file(picture.picture), *meshes], ViewFields(**values)
    values["camera"] = [dict(camera) for camera in picture.cameras]
    values |= {"state": picture.state} if picture.state is not None else {}
    values |= {"depth_scale_m": picture.depth_scale_m, "max_age_s": picture.max_age_s}
    values |= {} if picture.check_pose else {"check_pose": False}
    return [*map(_file, picture.pictures), *meshes], ViewFields(**values)


def form_of(*requests: Request) -> dict[str, str | list[str]]:
    """The fields of requests as a form holds them: those that were set, as JSON but for texts."""
    form: dict[str, str | list[str]] = {}
    for request in requests:
        for name, value in request.model_dump(mode="json", exclude_unset=True, exclude_none=True).items():
            if name in FORM_REPEATED:
                form[name] = [json.dumps(one) for one in value]
            else:
                form[name] = str(value) if name in FORM_TEXTS else json.dumps(value)
    return form


def npy_file(array: NDArray[Any]) -> bytes:
    """An array as a ``.npy`` file."""
    file = io.BytesIO()
    np.save(file, array, allow_pickle=False)
    return file.getvalue()


def _file(part: bytes | NDArray[Any]) -> Part:
    if isinstance(part, np.ndarray) and part.dtype.type is np.float32 and part.ndim == 2:
        return "image", ("depth.npy", npy_file(part.astype("<f4")), NPY)
    return "image", ("scenario.png", part if isinstance(part, bytes) else encode_png(part), _PNG)


def encode_png(image: NDArray[Any]) -> bytes:
    """Pixels as a PNG file: uint8 (H, W, 3) in colour, uint16 (H, W) in grey."""
    pixels = np.asarray(image)
    colour = pixels.dtype.type is np.uint8 and pixels.ndim == 3 and pixels.shape[2] == 3
    grey = pixels.dtype.type is np.uint16 and pixels.ndim == 2
    if not (colour or grey) or pixels.size == 0:
        raise SamplerError(
            "the picture cannot be sent",
            expected="a file, uint8 (P, P, 3), or uint16 (h, w) in mm or float32 in m of a depth camera",
            got=f"{pixels.dtype} {pixels.shape}",
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
