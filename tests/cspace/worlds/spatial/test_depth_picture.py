import io
from contextlib import suppress

import numpy as np
import pytest
from PIL import Image

from cspace.errors import ImageError
from cspace.worlds.spatial.camera import decode_depth, encode_depth, resize_depth
from tests.cspace.png_files import chunk, file, header

RNG = np.random.default_rng(2)
DEPTH = RNG.integers(0, 65536, (18, 25), dtype=np.uint16)
GOOD = encode_depth(DEPTH)
HEAD, END = header(25, 18, 16, 0), chunk(b"IEND")


def png(mode, size=(20, 20)):
    buffer = io.BytesIO()
    Image.new(mode, size).save(buffer, format="PNG")
    return buffer.getvalue()


def test_depth_pictures_come_back_bit_by_bit():
    decoded = decode_depth(GOOD)
    assert decoded.dtype == np.uint16
    np.testing.assert_array_equal(decoded, DEPTH)


REFUSED = {
    **{mode: png(mode) for mode in ("RGB", "RGBA", "L", "LA", "P")},
    "nothing": b"",
    "another format": b"\xff\xd8\xff\xe0" + bytes(100),
    "a huge header": file(header(2**31 - 1, 2**31 - 1, 16, 0), END),
    "one side too large": png("I;16", (2049, 18)),
    "one side too small": png("I;16", (25, 15)),
    "no pixels": file(HEAD, END),
    "animated": file(HEAD, chunk(b"acTL", bytes(8)), END),
    "pixels that are no zlib": file(HEAD, chunk(b"IDAT", b"garbage" * 9), END),
}


@pytest.mark.parametrize("name", REFUSED)
def test_other_files_are_refused(name):
    with pytest.raises(ImageError):
        decode_depth(REFUSED[name])


def test_damaged_files_are_refused_or_read_and_nothing_else():
    for _ in range(200):
        data = bytearray(GOOD)
        data[RNG.integers(len(data))] ^= 1 << RNG.integers(8)
        with suppress(ImageError):
            assert decode_depth(bytes(data)).shape == DEPTH.shape


def test_shrinking_takes_the_nearest_reading_of_a_cell_and_never_a_mean():
    depth = np.array([[5, 0, 0, 0], [9, 7, 0, 0], [3, 3, 8, 2], [3, 3, 0, 65535]], dtype=np.uint16)
    small = resize_depth(depth, 2, 2)
    assert small.dtype == np.uint16
    assert small.tolist() == [[5, 0], [3, 2]]


@pytest.mark.parametrize("size", [(7, 11), (18, 25), (5, 60), (36, 50)])
def test_a_resized_picture_holds_values_of_the_first_alone(size):
    depth = np.where(RNG.random(DEPTH.shape) < 0.3, 0, DEPTH).astype(np.uint16)
    resized = resize_depth(depth, *size)
    assert resized.shape == size
    assert np.isin(resized, depth).all()
    if size == depth.shape:
        np.testing.assert_array_equal(resized, depth)
    if size == (36, 50):
        np.testing.assert_array_equal(resized, np.repeat(np.repeat(depth, 2, axis=0), 2, axis=1))
