"""Decoding in bands against averaging of the whole picture; what it takes of memory; many threads at once."""

import io
import subprocess
import sys

import numpy as np
import pytest
from numpy.typing import NDArray
from PIL import Image

from cspace.worlds.planar.camera import decode_png
from tests.cspace.png_files import (
    GREY,
    KINDS,
    PALETTE,
    RGB,
    RGBA,
    chunk,
    file,
    header,
    pixels,
    random_samples,
)

END = chunk(b"IEND")


def exact_average(data: bytes, target: int) -> NDArray[np.float64]:
    """What decoding means, with the picture as floats of double precision at once, before rounding."""
    with Image.open(io.BytesIO(data)) as picture:
        if picture.mode in ("RGBA", "LA") or "transparency" in picture.info:
            rgba = picture.convert("RGBA")
            ground = Image.new("RGBA", rgba.size, (255, 255, 255, 255))
            rgb = np.asarray(Image.alpha_composite(ground, rgba).convert("RGB"))
        else:
            rgb = np.asarray(picture.convert("RGB"))
    side = len(rgb)
    edges = np.arange(target + 1) * (side / target)
    cells = np.arange(side)[None, :]
    covered = np.minimum(edges[1:, None], cells + 1) - np.maximum(edges[:-1, None], cells)
    weights = np.clip(covered, 0.0, None) * (target / side)
    rows = np.tensordot(weights, rgb.astype(np.float64), axes=(1, 0))
    return np.tensordot(weights, rows, axes=(1, 1)).transpose(1, 0, 2)


def assert_rounded(decoded: NDArray[np.uint8], exact: NDArray[np.float64]) -> None:
    """Every value is the nearest whole one; which of two is, single precision tells to a thousandth only."""
    assert decoded.shape == exact.shape
    assert np.abs(decoded - exact).max() <= 0.5 + 1e-3


def random_file(rng: np.random.Generator, side: int, depth: int, colour: int, interlace: int) -> bytes:
    """Half of those that may have a transparent colour do."""
    chunks = [header(side, side, depth, colour, interlace)]
    if colour == PALETTE:
        chunks.append(chunk(b"PLTE", rng.bytes(3 * 2**depth)))
    if rng.random() < 0.5:
        if colour == PALETTE:
            chunks.append(chunk(b"tRNS", rng.bytes(2**depth)))
        elif colour in (GREY, RGB):
            chunks.append(chunk(b"tRNS", b"\0\1" * (1 if colour == GREY else 3)))
    return file(*chunks, pixels(random_samples(rng, side, depth, colour), depth, interlace), END)


@pytest.mark.parametrize("interlace", [0, 1], ids=["rows", "interlaced"])
@pytest.mark.parametrize(("depth", "colour"), KINDS)
def test_every_kind_of_picture_is_averaged_and_rounded(depth: int, colour: int, interlace: int) -> None:
    rng = np.random.default_rng(100 * depth + 10 * colour + interlace)
    for side, target in ((16, 48), (17, 32), (48, 48), (129, 48), (int(rng.integers(130, 400)), 32)):
        data = random_file(rng, side, depth, colour, interlace)
        assert_rounded(decode_png(data, target), exact_average(data, target))


@pytest.mark.parametrize(("side", "colour"), [(1537, PALETTE), (2048, RGB)])
def test_large_pictures_are_averaged_and_rounded(side: int, colour: int) -> None:
    data = random_file(np.random.default_rng(side), side, 8, colour, 0)
    assert_rounded(decode_png(data), exact_average(data, 48))


MEMORY = """
import sys
import numpy as np
from cspace.files import encode_png
from cspace.worlds.planar.camera import decode_png

def kib(key):
    with open("/proc/self/status") as status:
        return next(int(line.split()[1]) for line in status if line.startswith(key))

decode_png(encode_png(np.zeros((200, 200, 3), np.uint8)))
data = open(sys.argv[1], "rb").read()
before = kib("VmRSS")
decode_png(data)
print(kib("VmHWM") - before)
"""


@pytest.mark.skipif(sys.platform != "linux", reason="reads /proc")
def test_the_largest_picture_takes_less_than_40_mb(tmp_path) -> None:
    samples = np.zeros((2048, 2048, 4), np.uint8)
    samples[:700, :, :3] = np.random.default_rng(0).integers(0, 256, (700, 2048, 3))
    samples[..., 3] = 200
    path = tmp_path / "large.png"
    path.write_bytes(file(header(2048, 2048, 8, RGBA), chunk(b"tEXt", b"k"), pixels(samples, 8), END))
    assert path.stat().st_size > 4_000_000
    done = subprocess.run([sys.executable, "-c", MEMORY, str(path)], capture_output=True, check=True)
    assert int(done.stdout) * 1024 < 40_000_000
