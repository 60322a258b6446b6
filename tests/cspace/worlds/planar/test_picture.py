import io

import numpy as np
import pytest
from PIL import Image

from cspace.errors import ImageError
from cspace.files import encode_png
from cspace.worlds.planar.camera import Camera, decode_png
from tests.cspace.png_files import SIGNATURE, chunk, file, header

PICTURE = np.random.default_rng(0).integers(0, 256, (48, 48, 3), dtype=np.uint8)


def png(picture, **options):
    buffer = io.BytesIO()
    picture.save(buffer, format="PNG", **options)
    return buffer.getvalue()


def plain(mode, colour, side=48):
    return Image.new(mode, (side, side), colour)


def test_an_rgb_picture_comes_back_as_it_was():
    np.testing.assert_array_equal(decode_png(encode_png(PICTURE)), PICTURE)


@pytest.mark.parametrize(
    ("picture", "colour"),
    [
        (plain("RGB", (1, 2, 3)), (1, 2, 3)),
        (plain("L", 100), (100, 100, 100)),
        (plain("1", 1), (255, 255, 255)),
        (plain("RGBA", (255, 0, 0, 255)), (255, 0, 0)),
        (plain("RGBA", (255, 0, 0, 0)), (255, 255, 255)),
        (plain("RGBA", (0, 0, 255, 51)), (204, 204, 255)),
        (plain("LA", (0, 0)), (255, 255, 255)),
        (plain("LA", (0, 255)), (0, 0, 0)),
        (plain("RGB", (9, 200, 30)).convert("P", palette=Image.Palette.ADAPTIVE), (9, 200, 30)),
    ],
    ids=["rgb", "grey", "bilevel", "opaque", "clear", "glass", "clear-grey", "opaque-grey", "palette"],
)
def test_other_kinds_of_pixels_become_rgb_over_white(picture, colour):
    decoded = decode_png(png(picture))
    assert decoded.dtype == np.uint8
    np.testing.assert_array_equal(decoded, np.broadcast_to(np.array(colour, dtype=np.uint8), (48, 48, 3)))


@pytest.mark.parametrize("mode", ["RGB", "RGBA", "L", "P"])
def test_a_picture_is_averaged_over_the_area_of_each_pixel(mode):
    rng = np.random.default_rng(0)
    for side, pixels in ((16, 48), (17, 32), (129, 48), (1537, 48)):
        noise = rng.integers(0, 256, (side, side, 4), dtype=np.uint8)
        picture = (
            Image.fromarray(noise).convert("RGB").convert(mode) if mode != "RGBA" else Image.fromarray(noise)
        )
        over = Image.new("RGBA", picture.size, "white")
        rgb = np.asarray(
            Image.alpha_composite(over, picture.convert("RGBA")).convert("RGB"), dtype=np.float64
        )
        edges, cells = np.arange(pixels + 1) * (side / pixels), np.arange(side)
        covered = np.minimum(edges[1:, None], cells + 1) - np.maximum(edges[:-1, None], cells)
        weights = np.clip(covered, 0.0, None) * (pixels / side)
        exact = np.einsum("ri,ijc,kj->rkc", weights, rgb, weights, optimize=True)
        # Which of two whole numbers is nearest, single precision tells to a thousandth only.
        assert np.abs(decode_png(png(picture), pixels) - exact).max() <= 0.5 + 1e-3


@pytest.mark.parametrize("side", [1, 15, 2049])
def test_other_sizes_are_refused(side):
    with pytest.raises(ImageError, match=rf"16 to 2048.*got {side} x {side}"):
        decode_png(png(plain("L", 0, side)))


def test_a_decompression_bomb_is_refused_by_its_header():
    with pytest.raises(ImageError, match="decompression bomb"):
        decode_png(file(header(60000, 60000), chunk(b"IDAT"), chunk(b"IEND")))


@pytest.mark.parametrize(
    "data",
    [
        b"",
        SIGNATURE,
        SIGNATURE + bytes(100),
        SIGNATURE + chunk(b"IHDR", bytes(14)),
        b"\xff\xd8\xff\xe0" + bytes(100),
    ],
    ids=["empty", "signature", "zeros", "no header", "JPEG"],
)
def test_what_is_no_png_is_refused(data):
    with pytest.raises(ImageError, match="not a PNG"):
        decode_png(data)


def test_the_network_takes_channels_first_from_minus_one_to_one():
    batch = Camera().to_network(np.stack([np.zeros_like(PICTURE), np.full_like(PICTURE, 255), PICTURE]))
    assert batch.dtype == np.float32
    assert batch.shape == (3, 3, 48, 48)
    assert batch.flags.c_contiguous
    assert (batch[0] == -1.0).all()
    assert (batch[1] == 1.0).all()
    assert batch[2, 1, 5, 7] == pytest.approx(PICTURE[5, 7, 1] / 127.5 - 1.0, abs=1e-6)


def test_a_large_picture_is_read_in_parts_between_which_a_caller_may_stop():
    class StopError(Exception):
        pass

    parts = []
    decode_png(png(plain("RGBA", (1, 2, 3, 4), side=1024)), check_cancelled=lambda: parts.append(1))
    assert len(parts) == 8

    def stop():
        raise StopError

    with pytest.raises(StopError):
        decode_png(png(plain("RGB", (1, 2, 3), side=256)), check_cancelled=stop)
