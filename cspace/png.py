"""Untrusted PNG files, read by Pillow, and how such files are written."""

import io
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from cspace.errors import ImageError


def decoded(data: bytes, check: Callable[[Image.Image], None]) -> Image.Image:
    """A file as Pillow decodes it; ``check`` refuses it by mode and size before that."""
    try:
        picture = Image.open(io.BytesIO(data), formats=["PNG"])
        if getattr(picture, "is_animated", False):
            raise ImageError("the picture is animated", expected="one frame")  # noqa: TRY301
        check(picture)
        picture.load()
    except ImageError:
        raise
    except Exception as error:
        # All, for there is no list of what a decoder raises for bytes from outside. Some of Pillow's messages
        # hold an object's address, which is nobody's business.
        text = str(error)
        raise ImageError(
            "the picture is not a PNG, or damaged",
            expected="a complete PNG file",
            got=type(error).__name__ if not text or "0x" in text else text[:200],
        ) from error
    return picture


def encode_png(image: NDArray[np.uint8]) -> bytes:
    """An RGB picture (H, W, 3) uint8 as PNG bytes."""
    buffer = io.BytesIO()
    Image.fromarray(np.ascontiguousarray(image, dtype=np.uint8)).save(buffer, format="PNG")
    return buffer.getvalue()
