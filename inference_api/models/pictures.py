"""Pictures that were decoded and encoded already, so that a robot that replans pays for that once."""

import hashlib
import time
from collections import OrderedDict
from collections.abc import Callable
from dataclasses import dataclass
from threading import Lock

import numpy as np
from numpy.typing import NDArray

from cspace.bundle import Bundle, Picture
from cspace.world import Between

# A dozen arrays of space, or all the flat pictures that are kept.
MOST_BYTES = 64 * 2**20


@dataclass(frozen=True, slots=True)
class Prepared:
    """A picture for a bundle, and what it took.

    Args:
        picture: decoded and encoded.
        decode_ms: 0 for one that was known.
        encode_ms: 0 for one that was known.
    """

    picture: Picture
    decode_ms: float = 0.0
    encode_ms: float = 0.0


class PictureCache:
    """The pictures asked for last, by bundle and content; safe to share between threads.

    Args:
        capacity: how many are kept, about 30 kB each, 40 with a map, arrays of space 5 MB; 0 keeps none.
        most_bytes: of all that are kept.
    """

    def __init__(self, capacity: int, most_bytes: int = MOST_BYTES) -> None:
        self._capacity, self._most_bytes, self._bytes = capacity, most_bytes, 0
        self._known: OrderedDict[tuple[str, bytes], Picture] = OrderedDict()
        self._lock = Lock()

    def get(
        self,
        bundle: Bundle,
        png: bytes,
        spend: Callable[[int], None] = lambda _: None,
        between: Between = lambda: None,
    ) -> Prepared:
        """A PNG file as a bundle takes it.

        Args:
            bundle: that takes it.
            png: the file.
            spend: told how many pixels have to be read of one that is not known, before they are.
            between: called between the parts of that; may raise to stop, which passes through.

        Raises:
            InputError: not a picture that is accepted.
            BundleError: the encoder fails.
        """
        world = bundle.spec.world

        def read() -> NDArray[np.uint8]:
            spend(world.pixels_of(png))
            image = world.read_picture(png, between)
            between()
            return image

        return self._get(bundle, b"png" + _digest(png), read)

    def of_pixels(self, bundle: Bundle, image: NDArray[np.uint8]) -> Prepared:
        """A picture that is decoded already, uint8 (P, P, 3).

        Raises:
            InputError: it has another size or type than the bundle takes.
            BundleError: the encoder fails.
        """
        return self._get(bundle, b"pixels" + _digest(np.ascontiguousarray(image).data), lambda: image)

    def _get(self, bundle: Bundle, content: bytes, decode: Callable[[], NDArray[np.uint8]]) -> Prepared:
        key = (bundle.digest, content)
        with self._lock:
            known = self._known.get(key)
            if known is not None:
                self._known.move_to_end(key)
                return Prepared(known)
        began = time.perf_counter()
        image = decode()
        decoded = time.perf_counter()
        picture = bundle.prepare(image)
        encoded = time.perf_counter()
        with self._lock:
            self._keep(key, picture)
        return Prepared(picture, 1e3 * (decoded - began), 1e3 * (encoded - decoded))

    def _keep(self, key: tuple[str, bytes], picture: Picture) -> None:
        known = self._known.pop(key, None)
        self._bytes += picture.size_bytes - (0 if known is None else known.size_bytes)
        self._known[key] = picture
        while self._known and (len(self._known) > self._capacity or self._bytes > self._most_bytes):
            self._bytes -= self._known.popitem(last=False)[1].size_bytes

    def __len__(self) -> int:
        with self._lock:
            return len(self._known)


def _digest(content: bytes | memoryview) -> bytes:
    # Not the builtin hash: two pictures that share a key would share an answer.
    return hashlib.sha256(content).digest()
