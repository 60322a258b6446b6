import struct
import zlib
from contextlib import suppress

import numpy as np
import pytest

from cspace.errors import ImageError
from cspace.worlds.spatial.camera import decode_depth, encode_depth, resize_depth, to_m, to_mm
from tests.cspace.png_files import GREY, GREY_ALPHA, PALETTE, RGB, RGBA, chunk, file, header, pixels

RNG = np.random.default_rng(2)
DEPTH = RNG.integers(0, 65536, (18, 25), dtype=np.uint16)
GOOD = encode_depth(DEPTH)
HEAD, END = header(25, 18, 16, GREY), chunk(b"IEND")


def body(depth, interlace=0):
    high_low = depth.astype(">u2").view(np.uint8).reshape(*depth.shape, 2)
    return pixels(high_low, 8, interlace)


def eight_bit(colour, channels):
    return file(header(20, 20, 8, colour), pixels(np.zeros((20, 20, channels), np.uint8), 8), END)


def test_depth_pictures_come_back_bit_by_bit():
    decoded = decode_depth(GOOD)
    assert decoded.dtype == np.uint16
    np.testing.assert_array_equal(decoded, DEPTH)


@pytest.mark.parametrize("interlace", [0, 1])
def test_files_of_other_encoders_are_read_interlaced_ones_too(interlace):
    data = file(header(25, 18, 16, GREY, interlace), chunk(b"tEXt", b"a\0b"), body(DEPTH, interlace), END)
    np.testing.assert_array_equal(decode_depth(data), DEPTH)


REFUSED = {
    "nothing": b"",
    "another format": b"\xff\xd8\xff\xe0" + bytes(100),
    "RGB": eight_bit(RGB, 3),
    "RGBA": eight_bit(RGBA, 4),
    "8-bit grey": eight_bit(GREY, 1),
    "grey with alpha": eight_bit(GREY_ALPHA, 2),
    "palette": file(header(20, 20, 8, PALETTE), chunk(b"PLTE", bytes(3)), chunk(b"IDAT"), END),
    "16-bit RGB": file(header(20, 20, 16, RGB), pixels(np.zeros((20, 20, 6), np.uint8), 8), END),
    "16-bit grey with alpha": file(header(20, 20, 16, GREY_ALPHA), body(DEPTH), END),
    "a huge header": file(header(2**31 - 1, 2**31 - 1, 16, GREY), body(DEPTH), END),
    "one side too large": file(header(2049, 18, 16, GREY), body(DEPTH), END),
    "one side too small": file(header(25, 15, 16, GREY), body(DEPTH), END),
    "no pixels": file(HEAD, END),
    "two headers": file(HEAD, header(2000, 2000, 16, GREY), body(DEPTH), END),
    "animated": file(HEAD, chunk(b"acTL", bytes(8)), body(DEPTH), END),
    "too few pixels of an interlaced file": file(header(25, 18, 16, GREY, 1), body(DEPTH[:16], 1), END),
    "pixels that are no zlib": file(HEAD, chunk(b"IDAT", b"garbage" * 9), END),
    "a filter that is none": file(HEAD, chunk(b"IDAT", zlib.compress(b"\x09" * (18 * 51))), END),
}


@pytest.mark.parametrize("name", REFUSED)
def test_other_files_are_refused_and_other_kinds_of_pictures_told_as_such(name):
    kind = "no depth picture; expected 16-bit grey" if "RGB" in name or "grey" in name else None
    with pytest.raises(ImageError, match=kind):
        decode_depth(REFUSED[name])


def test_every_truncated_file_is_refused():
    for length in range(0, len(GOOD) - 40, 3):
        with pytest.raises(ImageError):
            decode_depth(GOOD[:length])


def test_damaged_files_are_refused_or_read_and_nothing_else():
    for _ in range(200):
        data = bytearray(GOOD)
        data[RNG.integers(len(data))] ^= 1 << RNG.integers(8)
        with suppress(ImageError):
            assert decode_depth(bytes(data)).shape == DEPTH.shape


def test_a_bomb_costs_no_more_than_its_header_says():
    bomb = zlib.compress(bytes(50 << 20), 1)
    decoded = decode_depth(file(HEAD, chunk(b"IDAT", bomb), END))
    assert decoded.shape == (18, 25)
    assert not decoded.any()
    with pytest.raises(ImageError, match="decompression bomb"):
        decode_depth(file(chunk(b"IHDR", struct.pack(">IIBBBBB", 40000, 40000, 16, 0, 0, 0, 0)), END))


@pytest.mark.parametrize("depth", [DEPTH.astype(np.int32), DEPTH[0], np.zeros((0, 3), np.uint16)])
def test_other_arrays_are_not_encoded(depth):
    with pytest.raises(ImageError):
        encode_depth(depth)


def test_metres_become_millimetres_and_what_none_can_hold_no_reading():
    depth = [0.0, 0.0004, 0.0006, 1.2344, 1.2346, 65.535, 65.54, -1.0, np.nan, np.inf]
    assert to_mm(depth).tolist() == [0, 0, 1, 1234, 1235, 65535, 0, 0, 0, 0]
    np.testing.assert_allclose(to_m(to_mm([1.234, 0.0])), [1.234, 0.0], atol=1e-6)
    np.testing.assert_array_equal(to_mm(to_m(DEPTH)), DEPTH)


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
