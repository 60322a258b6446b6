"""The fields of a request that show the scene: pictures, and for depth cameras where these are."""

import base64
import binascii
from typing import Annotated, Any

from pydantic import BeforeValidator, Field, Strict, WithJsonSchema

from cspace.errors import InputError
from cspace.view_file import MAX_PICTURES, pack_view

MAX_JOINTS = 64
# What the world of depth cameras takes.
MIN_SCALE_M, MAX_SCALE_M = 1e-6, 1.0
# More than any bound, so that too many are told as that.
_MOST = 16
PICTURE_EXPECTED = {
    "image": "a PNG: a file in a form, base64 text in JSON; several, each with a camera, for depth cameras",
    "camera": "objects of fx, fy, cx, cy and pose, one for each image",
    "state": "an array of finite angles in rad",
    "depth_scale_m": f"metres per unit of the depth pictures, {MIN_SCALE_M:g} to {MAX_SCALE_M:g}",
}


def _decode_image(value: object) -> object:
    """Base64 text to bytes; bytes stay as they are (a file of a multipart body)."""
    if not isinstance(value, str):
        return value
    try:
        return base64.b64decode(value, validate=True)
    except (binascii.Error, ValueError) as error:
        raise ValueError("not base64") from error


def _as_tuple(value: object) -> object:
    return tuple(value) if isinstance(value, list) else (value,)


_File = Annotated[bytes, BeforeValidator(_decode_image)]
_FILE_SCHEMA = {"type": "string", "contentEncoding": "base64", "contentMediaType": "image/png"}
PictureFiles = Annotated[
    Annotated[tuple[_File, ...], Field(min_length=1, max_length=_MOST)],
    BeforeValidator(_as_tuple),
    WithJsonSchema(
        {
            "anyOf": [
                _FILE_SCHEMA,
                {"type": "array", "items": _FILE_SCHEMA, "minItems": 1, "maxItems": MAX_PICTURES},
            ]
        }
    ),
]
_NUMBER = {"type": "number"}
_ROW = {"type": "array", "items": _NUMBER, "minItems": 4, "maxItems": 4}
_POSE = {"type": "array", "items": _ROW, "minItems": 4, "maxItems": 4}


def _camera_schema(**properties: dict[str, Any]) -> dict[str, Any]:
    members = dict.fromkeys(("fx", "fy", "cx", "cy"), _NUMBER) | properties | {"pose": _POSE}
    return {
        "type": "object",
        "properties": members,
        "required": list(members),
        "additionalProperties": False,
    }


_CAMERA_SCHEMA = _camera_schema()
_VIEW_SCHEMA = _camera_schema(width={"type": "integer"}, height={"type": "integer"})
# What is in a camera is judged by the world that has cameras.
Cameras = Annotated[
    Annotated[tuple[dict[str, Any], ...], Field(max_length=_MOST)],
    BeforeValidator(_as_tuple),
    WithJsonSchema(
        {"anyOf": [_CAMERA_SCHEMA, {"type": "array", "items": _CAMERA_SCHEMA, "maxItems": MAX_PICTURES}]}
    ),
]
MAX_VIEWS = 64
# Cameras that have taken no picture yet.
Views = Annotated[
    Annotated[tuple[dict[str, Any], ...], Field(max_length=MAX_VIEWS)],
    BeforeValidator(_as_tuple),
    WithJsonSchema(
        {"anyOf": [_VIEW_SCHEMA, {"type": "array", "items": _VIEW_SCHEMA, "maxItems": MAX_VIEWS}]}
    ),
]
Angle = Annotated[float, Field(allow_inf_nan=False)]
Scale = Annotated[float, Field(ge=MIN_SCALE_M, le=MAX_SCALE_M, allow_inf_nan=False)]
Configuration = Annotated[tuple[Angle, ...], Field(max_length=MAX_JOINTS), Strict(strict=False)]

CAMERA_TOLD = (
    "For models of depth cameras and only for them, one for each image in the same order: focal lengths and "
    "centre in pixels, pixel centres at whole numbers, and `pose`, 4 x 4, of the camera in the robot's base: "
    "x right, y down, z forward, m."
)
STATE_TOLD = "Where the robot was when the pictures were taken, rad; absent, it is in none of them."
SCALE_TOLD = (
    "Metres that one unit of the depth pictures stands for: 0.001 (mm) when absent, 0.0001 for tenths of "
    "a mm, 0.0002 for TUM RGB-D. Goes with `camera`."
)


def picture_of(
    images: tuple[bytes, ...],
    cameras: tuple[dict[str, Any], ...],
    state: tuple[float, ...] | None,
    depth_scale_m: float | None = None,
) -> bytes:
    """The one file that a world reads as the picture of a scene.

    Raises:
        ImageError: there is not a camera for each of several images.
        InputError: several images come without cameras, or a unit of depths does.
    """
    if not cameras and depth_scale_m is not None:
        raise InputError(
            "depth_scale_m comes without a camera",
            expected="it beside camera, for depth pictures; a view file has it inside",
            got=f"{depth_scale_m:g}",
        )
    if not cameras and state is None:
        if len(images) > 1:
            raise InputError(
                "image is repeated",
                expected="one, or a camera for each",
                got=f"{len(images)} without cameras",
            )
        return images[0]
    return pack_view(images, cameras, None if state is None else list(state), depth_scale_m)
