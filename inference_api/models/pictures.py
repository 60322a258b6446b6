"""Pictures that were decoded and encoded already, so that a robot that replans pays for that once."""

import hashlib
import time
from collections.abc import Callable, MutableMapping
from contextlib import suppress
from dataclasses import dataclass, replace
from threading import Lock
from typing import Any

import numpy as np
from cachetools import LRUCache
from numpy.typing import NDArray

from cspace.bundle import Bundle, Picture
from cspace.world import CheckCancelled, Examined, Finding, World

# A dozen arrays of space, or all the flat pictures that are kept.
MOST_BYTES = 20 * 2**20


@dataclass(frozen=True, slots=True)
class Prepared:
    """A picture for a bundle, and what it took.

    Args:
        picture: decoded and encoded.
        decode_ms: 0 for one that was known.
        encode_ms: 0 for one that was known.
        findings: what answers say of the picture.
        without_state: whether it is not known where the robot stands in it.
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
    """The pictures asked for last, by bundle and content; safe to share between threads.

    Args:
        capacity: how many are kept, about 10 kB each, 20 with a map, arrays of space 1.7 MB; 0 keeps none.
        most_bytes: of all that are kept.
    """

    def __init__(self, capacity: int, most_bytes: int = MOST_BYTES) -> None:
        self._capacity = capacity
        self._known: MutableMapping[tuple[str, bytes], Prepared] = LRUCache(
            most_bytes, lambda prepared: prepared.picture.size_bytes
        )
        self._lock = Lock()

    def get(
        self,
        bundle: Bundle,
        png: bytes,
        spend: Callable[[int], None] = lambda _: None,
        check_cancelled: CheckCancelled = lambda: None,
    ) -> Prepared:
        """A PNG file as a bundle takes it.

        Args:
            bundle: that takes it.
            png: the file.
            spend: told how many pixels have to be read of one that is not known, before they are.
            check_cancelled: called between the parts of that; may raise to stop, which passes through.

        Raises:
            InputError: not a picture that is accepted.
            BundleError: the encoder fails.
        """
        world = bundle.spec.world

        def read() -> Examined:
            spend(world.pixels_of(png))
            found = world.examine_picture(png, check_cancelled)
            check_cancelled()
            return found

        return self._get(bundle, b"png" + _digest(png), read)

    def of_pixels(self, bundle: Bundle, image: NDArray[np.uint8]) -> Prepared:
        """A picture that is decoded already, uint8 (P, P, 3).

        Raises:
            InputError: it has another size or type than the bundle takes.
            BundleError: the encoder fails.
        """
        return self._get(
            bundle, b"pixels" + _digest(np.ascontiguousarray(image).data), lambda: Examined(image[None])
        )

    def _get(self, bundle: Bundle, content: bytes, decode: Callable[[], Examined]) -> Prepared:
        key = (bundle.digest, content)
        with self._lock:
            known = self._known.get(key)
        if known is not None:
            # A copy: the pixels for the graphs go with the request.
            return replace(known, picture=replace(known.picture))
        began = time.perf_counter()
        read = decode()
        decoded = time.perf_counter()
        prepared = Prepared(bundle.prepare(read), 0.0, 0.0, read.findings, read.without_state)
        encoded = time.perf_counter()
        # Without the pixels for the graphs, and without the request's body, of which the image may be a view.
        kept = replace(prepared, picture=replace(prepared.picture, image=read.images[0].copy()))
        # One that alone is larger than all may be is not kept.
        with self._lock, suppress(ValueError):
            self._known[key] = kept
            while len(self._known) > self._capacity:
                self._known.popitem()
        return replace(prepared, decode_ms=1e3 * (decoded - began), encode_ms=1e3 * (encoded - decoded))

    def __len__(self) -> int:
        with self._lock:
            return len(self._known)


def _digest(content: bytes | memoryview) -> bytes:
    # Not the builtin hash: two pictures that share a key would share an answer.
    return hashlib.sha256(content).digest()
