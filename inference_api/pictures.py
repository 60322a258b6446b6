"""Decoded and encoded pictures, of which the last are kept: a robot that replans pays once."""

import time
from collections.abc import MutableMapping
from contextlib import suppress
from dataclasses import dataclass, replace
from threading import Lock
from typing import Annotated, Any

from cachetools import LRUCache
from fastapi import Depends, Request

from cspace.bundle import Bundle, Picture
from cspace.errors import ImageError
from cspace.view_file import View
from cspace.world import POSE_CODES, CheckCancelled, Finding, World

# A dozen arrays of space, or all the flat ones.
MAX_BYTES = 20 * 2**20


@dataclass(frozen=True, slots=True)
class Prepared:
    """A decoded and encoded picture for a bundle, what that took, and what answers say of the picture.

    Both times are 0 for a known picture. Without state nobody knows where the robot stands in it.
    """

    picture: Picture
    decode_ms: float = 0.0
    encode_ms: float = 0.0
    findings: tuple[Finding, ...] = ()
    without_state: bool = False

    def findings_with(self, world: World, **answer: Any) -> tuple[Finding, ...]:
        """With those that an answer shows, which :meth:`cspace.world.World.state_findings` tells of."""
        return self.findings + (world.state_findings(**answer) if self.without_state else ())


class PictureCache:
    """Prepared pictures by bundle and view; safe to share between threads."""

    def __init__(self, most: int = 256) -> None:
        self._most, self._lock = most, Lock()
        self._kept: MutableMapping[tuple[str, bytes], Prepared] = LRUCache(
            MAX_BYTES, lambda prepared: prepared.picture.size_bytes
        )

    def prepare(
        self, bundle: Bundle, view: View, check_cancelled: CheckCancelled, check_pose: bool = False
    ) -> Prepared:
        """Pictures for a bundle, from memory where they were before.

        With ``check_pose`` a pose or state by which the arm is clearly elsewhere is refused.

        Raises:
            ImageError: a picture or a camera is none that is accepted.
            InputError: what is known does not fit.
        """
        prepared = self._prepared(bundle, view, check_cancelled)
        wrong = [one for one in prepared.findings if one.code in POSE_CODES]
        if check_pose and wrong:
            raise ImageError(
                f"the arm is not where `state` and the camera's pose put it: {wrong[0].code}",
                expected="the arm in the picture where `state` and `pose` say",
                got=wrong[0].seen,
                remedy=f"{wrong[0].remedy}; POST /doctor looks closer; check_pose false answers all the same",
            )
        return prepared

    def _prepared(self, bundle: Bundle, view: View, check_cancelled: CheckCancelled) -> Prepared:
        key = bundle.digest, view.digest()
        with self._lock:
            known = self._kept.get(key)
        if known is not None:
            # A copy: the pixels for the graphs go with the request.
            return replace(known, picture=replace(known.picture))
        began = time.perf_counter()
        examined = bundle.spec.world.examine_picture(view, check_cancelled)
        decoded = time.perf_counter()
        check_cancelled()
        made = Prepared(
            bundle.prepare(examined), findings=examined.findings, without_state=examined.without_state
        )
        encoded = time.perf_counter()
        # Without the pixels for the graphs, and without the request's body, of which the image may be a view.
        picture = replace(made.picture, image=made.picture.image.copy())
        # One that alone is larger than all may be is not kept.
        with self._lock, suppress(ValueError):
            self._kept[key] = replace(made, picture=picture)
            while len(self._kept) > self._most:
                self._kept.popitem()
        return replace(made, decode_ms=1e3 * (decoded - began), encode_ms=1e3 * (encoded - decoded))


async def _pictures_of(request: Request) -> PictureCache:
    pictures: PictureCache = request.app.state.pictures
    return pictures


# What routes take.
PreparedPictures = Annotated[PictureCache, Depends(_pictures_of)]
