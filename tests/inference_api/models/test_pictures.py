from pathlib import Path

import pytest

from cspace.bundle import Bundle
from cspace.errors import InputError
from cspace.png import encode_png
from inference_api.models.pictures import PictureCache
from tests.bundles import picture


@pytest.fixture(scope="module")
def bundle(bundles: dict[str, Path]) -> Bundle:
    return Bundle.load(bundles["plain"])


def png_of(seed: int) -> bytes:
    return encode_png(picture(seed))


def test_a_known_picture_comes_back_as_it_was(bundle: Bundle) -> None:
    cache = PictureCache(2)
    first, again = cache.get(bundle, png_of(0)), cache.get(bundle, png_of(0))
    assert again.picture.encoding is first.picture.encoding
    assert first.decode_ms > 0.0 < first.encode_ms
    assert (again.decode_ms, again.encode_ms) == (0.0, 0.0)


def test_the_least_recently_used_is_dropped(bundle: Bundle) -> None:
    cache = PictureCache(2)
    kept = cache.get(bundle, png_of(0)).picture.encoding
    dropped = cache.get(bundle, png_of(1)).picture.encoding
    assert cache.get(bundle, png_of(0)).picture.encoding is kept
    cache.get(bundle, png_of(2))
    assert len(cache) == 2
    assert cache.get(bundle, png_of(0)).picture.encoding is kept
    assert cache.get(bundle, png_of(1)).picture.encoding is not dropped


def test_pixels_are_known_by_what_they_are(bundle: Bundle) -> None:
    cache = PictureCache(2)
    first, again = cache.of_pixels(bundle, picture(0)), cache.of_pixels(bundle, picture(0).copy())
    assert again.picture.encoding is first.picture.encoding
    assert again.encode_ms == 0.0 < first.encode_ms
    assert cache.of_pixels(bundle, picture(1)).picture.encoding is not first.picture.encoding
    with pytest.raises(InputError):
        cache.of_pixels(bundle, picture(0)[:-1])
    assert len(cache) == 2


def test_without_room_nothing_is_kept(bundle: Bundle) -> None:
    cache = PictureCache(0)
    assert cache.get(bundle, png_of(0)).encode_ms > 0.0
    assert cache.get(bundle, png_of(0)).encode_ms > 0.0
    assert len(cache) == 0


def test_what_is_no_picture_is_refused_and_not_kept(bundle: Bundle) -> None:
    cache = PictureCache(2)
    with pytest.raises(InputError):
        cache.get(bundle, b"no picture")
    assert len(cache) == 0


def test_large_pictures_are_kept_as_long_as_they_fit(bundle: Bundle) -> None:
    size = PictureCache(1).get(bundle, png_of(0)).picture.size_bytes
    cache = PictureCache(100, most_bytes=2 * size)
    for seed in (0, 1, 2, 1):
        cache.get(bundle, png_of(seed))
    assert len(cache) == 2
    assert cache.get(bundle, png_of(2)).encode_ms == 0.0
    assert cache.get(bundle, png_of(0)).encode_ms > 0.0
    small = PictureCache(100, most_bytes=size - 1)
    small.get(bundle, png_of(0))
    assert len(small) == 0
