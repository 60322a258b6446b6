"""Pictures with the cameras that took them and where the robot was: a value, and a file that holds it.

A view file is a line and the pictures' files behind it, one after the other. The line is the word
``cspace-view``, the version 1, and an object in JSON with ``pictures`` (their sizes in bytes), ``cameras``
(each in a form of :func:`cspace.worlds.spatial.camera.read_pinhole`; ``link`` and ``stamp_s`` may stand
beside it), ``state`` (rad, or null where the robot is in no picture, or a list with one or the other for each
picture) and, where the unit of the pictures is another, ``depth_scale_m`` (metres per unit); ``known`` is the
size in bytes of a planning scene in JSON behind the pictures, where there is one. The world that takes the
pictures decodes and checks them.
"""

import hashlib
import json
import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import accumulate, pairwise
from typing import Annotated

from pydantic import NonNegativeInt

from cspace.errors import ImageError, InputError
from cspace.files import LEFT_OUT, read_json, read_object, validated

MAX_PICTURES = 4
# Of what is known beside pictures.
MAX_BODIES, MAX_ATTACHED, MAX_IGNORED, MAX_PAIRS = 500, 16, 64, 1000
MAX_TRIANGLES, MAX_MESHES = 20_000, 32
_MAGIC = b"cspace-view 1 "
_MAX_LINE_BYTES = 16_384
_STAMP = "stamp_s"
# A stamp so far ahead is of a clock that nearly agrees.
_AHEAD_S = 1.0


@dataclass(frozen=True, slots=True, eq=False)
class View:
    """Untrusted pictures of one scene, and what was sent beside them."""

    pictures: Sequence[bytes]
    cameras: Sequence[object] = ()
    state: object = None  # a configuration for all pictures, or a list of one or None for each
    depth_scale_m: object = None  # metres per unit of the pictures; None for mm
    known: bytes | None = None  # JSON of a planning scene; None without one

    @classmethod
    def of(cls, data: "bytes | View") -> "View":
        """A view file's contents; any other file is a picture alone."""
        if isinstance(data, View):
            return data
        return unpack_view(data) if is_view(data) else cls((data,))

    def digest(self) -> bytes:
        sizes = [len(one) for one in self.pictures]
        rest = json.dumps([sizes, list(self.cameras), self.state, self.depth_scale_m])
        found = hashlib.sha256(rest.encode())
        for part in (*self.pictures, self.known or b""):
            found.update(part)
        return found.digest()

    def packed(self) -> bytes:
        """The file: a view file, or the picture where it is alone."""
        if len(self.pictures) == 1 and not self.cameras and self.state is None and self.known is None:
            return self.pictures[0]
        return pack_view(self.pictures, self.cameras, self.state, self.depth_scale_m, self.known)


def is_view(data: bytes) -> bool:
    """Whether a file says that it is one."""
    return data.startswith(_MAGIC)


def pack_view(
    pictures: Sequence[bytes],
    cameras: Sequence[object],
    state: object,
    depth_scale_m: object = None,
    known: bytes | None = None,
) -> bytes:
    """A view file of what a :class:`View` holds."""
    header = {"pictures": [len(one) for one in pictures], "cameras": list(cameras), "state": state}
    # Readers of files in mm need not know the key.
    header |= {} if depth_scale_m is None else {"depth_scale_m": depth_scale_m}
    header |= {} if known is None else {"known": len(known)}
    line = json.dumps(header, separators=(",", ":")).encode()
    if len(line) > _MAX_LINE_BYTES:
        raise ImageError("the cameras are too long", expected=f"at most {_MAX_LINE_BYTES} bytes")
    return b"".join((_MAGIC, line, b"\n", *pictures, known or b""))


@validated(ImageError)
class _Line:
    pictures: tuple[NonNegativeInt, ...]
    cameras: list[object]
    state: object
    depth_scale_m: Annotated[object, LEFT_OUT] = None
    known: Annotated[NonNegativeInt | None, LEFT_OUT] = None


def unpack_view(data: bytes) -> View:
    """What an untrusted view file holds, as :func:`pack_view` takes it."""
    line, _, rest = data.removeprefix(_MAGIC).partition(b"\n")
    if not is_view(data) or len(line) > _MAX_LINE_BYTES:
        raise ImageError(
            "the file is no view", expected=f"one that begins with {_MAGIC!r}", got=repr(data[:20])
        )
    header = read_object(_Line, read_json(line, "the view", ImageError), "the view", ImageError)
    # A picture of a plane has no camera.
    if (len(header.pictures), len(header.cameras)) != (1, 0) or header.known is None:
        check_counts(len(header.pictures), len(header.cameras))
    sizes = [*header.pictures, header.known or 0]
    if sum(sizes) != len(rest):
        raise ImageError("the file is no view", expected=f"{sum(sizes)} bytes of parts", got=f"{len(rest)}")
    *files, known = (rest[begin:end] for begin, end in pairwise(accumulate(sizes, initial=0)))
    return View(files, header.cameras, header.state, header.depth_scale_m, known or None)


def unstamped(cameras: Sequence[object]) -> tuple[list[object], list[float | None]]:
    """Cameras without ``stamp_s``, and these: seconds since the epoch, None where a camera has none."""
    bare, stamps = list[object](), list[float | None]()
    for camera in cameras:
        if not isinstance(camera, Mapping) or _STAMP not in camera:
            bare.append(camera)
            stamps.append(None)
            continue
        stamp = camera[_STAMP]
        if type(stamp) not in (int, float) or not abs(stamp) <= sys.float_info.max:
            expected = "a finite number, seconds since the epoch"
            raise ImageError(f"{_STAMP} does not fit", expected=expected, got=repr(stamp)[:200])
        bare.append({name: value for name, value in camera.items() if name != _STAMP})
        stamps.append(float(stamp))
    return bare, stamps


def check_ages(stamps_s: Sequence[float | None], max_age_s: float, now_s: float) -> None:
    """Refuse pictures that are too old, or from the future, by their stamps, seconds since the epoch."""
    for number, stamp in enumerate(stamps_s):
        if stamp is None:
            raise InputError(
                f"picture {number} has no stamp",
                expected=f"{_STAMP} in each camera, where there is max_age_s",
                got="none",
                remedy=f"send when the picture was taken as {_STAMP}, in seconds since the epoch",
            )
        age_s = now_s - stamp
        if not -_AHEAD_S <= age_s <= max_age_s:
            old = f"{age_s:.3f} s old" if age_s > 0.0 else f"from {-age_s:.3f} s in the future"
            raise ImageError(
                f"picture {number} is {old}",
                expected=f"at most {max_age_s:g} s old and {_AHEAD_S:g} s ahead by this clock",
                got=f"{_STAMP} {stamp:.3f} at {now_s:.3f}",
                remedy=f"send a newer picture; if this one is new, set both clocks, and send {_STAMP} in "
                "seconds since the epoch",
            )


def check_counts(pictures: int, cameras: int) -> None:
    """Refuse numbers of pictures and cameras that do not fit."""
    if not 1 <= pictures <= MAX_PICTURES or pictures != cameras:
        raise ImageError(
            "the depth pictures do not fit",
            expected=f"1 to {MAX_PICTURES} pictures and a camera each, in the same order",
            got=f"{pictures} pictures, {cameras} cameras",
        )
