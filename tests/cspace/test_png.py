"""What of a PNG file reaches the decoder, and which files never do."""

import io
import struct
import zlib
from collections.abc import Callable

import numpy as np
import pytest
from PIL import Image, PngImagePlugin

from cspace.errors import ImageError
from cspace.png import MAX_CHUNKS, canonical_png, read_header
from cspace.worlds.planar.camera import decode_png
from tests.cspace.png_files import (
    GREY,
    GREY_ALPHA,
    PALETTE,
    RGB,
    RGBA,
    chunk,
    file,
    header,
    pixels,
    random_samples,
)

SIDE = 20
RNG = np.random.default_rng(3)
HEAD, BODY, END = header(SIDE, SIDE), pixels(random_samples(RNG, SIDE, 8, RGB), 8), chunk(b"IEND")
GOOD = file(HEAD, BODY, END)
COLOURS = chunk(b"PLTE", bytes(range(9)))
INDICES = pixels(random_samples(RNG, SIDE, 1, PALETTE), 8)
GREYS = pixels(random_samples(RNG, SIDE, 8, GREY), 8)
PALETTE_HEAD, GREY_HEAD = header(SIDE, SIDE, 8, PALETTE), header(SIDE, SIDE, 8, GREY)


def canonical(data: bytes) -> bytes:
    return canonical_png(data, read_header(data))


def broken(of: bytes) -> bytes:
    return of[:-1] + bytes([of[-1] ^ 1])


def halves(of: bytes) -> tuple[bytes, bytes]:
    data = of[8:-4]
    return chunk(b"IDAT", data[: len(data) // 2]), chunk(b"IDAT", data[len(data) // 2 :])


REFUSED: dict[str, Callable[[], bytes]] = {
    "a second header of another size": lambda: file(HEAD, header(9400, 9400), BODY, END),
    "the same header twice": lambda: file(HEAD, HEAD, BODY, END),
    "a header behind the pixels": lambda: file(HEAD, BODY, HEAD, END),
    "a header with a wrong sum": lambda: file(broken(HEAD), BODY, END),
    "a depth that RGB does not have": lambda: file(header(SIDE, SIDE, 4, RGB), BODY, END),
    "a palette of 16 bits": lambda: file(header(SIDE, SIDE, 16, PALETTE), COLOURS, BODY, END),
    "a colour type that is none": lambda: file(header(SIDE, SIDE, 8, 5), BODY, END),
    "an interlacing that is none": lambda: file(header(SIDE, SIDE, 8, RGB, 2), BODY, END),
    "a compression that is none": lambda: file(
        chunk(b"IHDR", struct.pack(">IIBBBBB", SIDE, SIDE, 8, 2, 1, 0, 0)), BODY, END
    ),
    "no pixels": lambda: file(HEAD, END),
    "pixels with a wrong sum": lambda: file(HEAD, broken(BODY), END),
    "pixels in two places": lambda: file(HEAD, halves(BODY)[0], chunk(b"tEXt"), halves(BODY)[1], END),
    "no end": lambda: file(HEAD, BODY),
    "half an end": lambda: GOOD[:-5],
    "an end with a wrong sum": lambda: file(HEAD, BODY, broken(END)),
    "an end with contents": lambda: file(HEAD, BODY, chunk(b"IEND", b"x")),
    "a chunk that is longer than the file": lambda: file(HEAD, b"\x7f\xff\xff\xfftEXt", BODY, END),
    "a chunk that everybody has to know": lambda: file(HEAD, chunk(b"CgBI", b"1234"), BODY, END),
    "a chunk without a name": lambda: file(HEAD, chunk(b"te\0t"), BODY, END),
    "a palette image without one": lambda: file(PALETTE_HEAD, INDICES, END),
    "two palettes": lambda: file(PALETTE_HEAD, COLOURS, COLOURS, INDICES, END),
    "a palette behind the pixels": lambda: file(HEAD, BODY, COLOURS, END),
    "half a colour": lambda: file(PALETTE_HEAD, chunk(b"PLTE", bytes(10)), INDICES, END),
    "no colour": lambda: file(PALETTE_HEAD, chunk(b"PLTE"), INDICES, END),
    "257 colours": lambda: file(PALETTE_HEAD, chunk(b"PLTE", bytes(771)), INDICES, END),
    "a transparency behind the pixels": lambda: file(GREY_HEAD, GREYS, chunk(b"tRNS", b"\0\1"), END),
    "a transparency before its palette": lambda: file(
        PALETTE_HEAD, chunk(b"tRNS", b"\0"), COLOURS, INDICES, END
    ),
    "a transparency of more colours than there are": lambda: file(
        PALETTE_HEAD, COLOURS, chunk(b"tRNS", bytes(4)), INDICES, END
    ),
    "an empty transparency": lambda: file(PALETTE_HEAD, COLOURS, chunk(b"tRNS"), INDICES, END),
    "a grey transparency of RGB": lambda: file(HEAD, chunk(b"tRNS", b"\0\1"), BODY, END),
    "a transparency beside an alpha": lambda: file(
        header(SIDE, SIDE, 8, GREY_ALPHA), chunk(b"tRNS", b"\0\1"), BODY, END
    ),
    "too many chunks": lambda: file(HEAD, chunk(b"tEXt") * MAX_CHUNKS, BODY, END),
    "fewer rows than the header says": lambda: file(header(2048, 2048), BODY, END),
    "a stream that is none": lambda: file(HEAD, chunk(b"IDAT", b"no zlib stream at all"), END),
    "empty pixels": lambda: file(HEAD, chunk(b"IDAT") * 5, END),
}


@pytest.mark.parametrize("name", REFUSED)
def test_a_file_that_no_encoder_writes_is_damaged(name: str) -> None:
    with pytest.raises(ImageError, match="damaged") as caught:
        decode_png(REFUSED[name]())
    assert " at 0x" not in str(caught.value)


@pytest.mark.parametrize("kind", [b"acTL", b"fcTL", b"fdAT"])
def test_every_chunk_of_an_animation_tells_it(kind: bytes) -> None:
    with pytest.raises(ImageError, match="animated"):
        decode_png(file(HEAD, chunk(kind, bytes(8)), BODY, END))


def test_a_second_header_never_reaches_the_decoder(monkeypatch: pytest.MonkeyPatch) -> None:
    def fail(*_: object, **__: object) -> None:
        pytest.fail("the decoder was asked")

    monkeypatch.setattr(Image, "open", fail)
    with pytest.raises(ImageError, match="IHDR"):
        decode_png(REFUSED["a second header of another size"]())


@pytest.mark.parametrize(
    "error",
    [
        Image.DecompressionBombError("x"),
        Image.UnidentifiedImageError("cannot identify image file <_io.BytesIO object at 0x7f1>"),
        MemoryError(),
        AttributeError("x"),
        UserWarning("x"),
    ],
    ids=lambda error: type(error).__name__,
)
def test_whatever_the_decoder_raises_is_an_image_error_without_addresses(
    monkeypatch: pytest.MonkeyPatch, error: Exception
) -> None:
    def fail(*_: object, **__: object) -> None:
        raise error

    monkeypatch.setattr(Image, "open", fail)
    with pytest.raises(ImageError, match="damaged") as caught:
        decode_png(GOOD)
    assert "0x" not in str(caught.value)


def test_a_canonical_file_is_not_copied() -> None:
    assert canonical(GOOD) is GOOD


def test_only_chunks_that_pixels_depend_on_are_kept() -> None:
    comment = zlib.compress(bytes(10**6))
    extras = [
        chunk(b"gAMA", b"\0\0\xb1\x8f"),
        chunk(b"iCCP", b"p\0\0" + comment),
        chunk(b"zTXt", b"k\0\0" + comment),
        chunk(b"iTXt", b"k\0\1\0\0\0" + comment),
        chunk(b"eXIf", b"II*\0" + bytes(99)),
        b"\0\0\0\1tEXtx????",
    ]
    full = file(HEAD, *extras, COLOURS, BODY, chunk(b"tIME", bytes(7)), END, b"rest")
    assert canonical(full) == GOOD
    clear = chunk(b"tRNS", b"\1\2")
    assert canonical(file(PALETTE_HEAD, *extras, COLOURS, extras[0], clear, INDICES, END)) == file(
        PALETTE_HEAD, COLOURS, clear, INDICES, END
    )


def test_a_bomb_in_a_comment_is_never_inflated_nor_is_looked_at_what_comes_behind_the_end() -> None:
    comment = PngImagePlugin.PngInfo()
    comment.add_text("comment", "x" * 5_000_000, zip=True)
    buffer = io.BytesIO()
    picture = Image.new("RGB", (48, 48), (1, 2, 3))
    picture.save(buffer, "PNG", pnginfo=comment)
    np.testing.assert_array_equal(decode_png(buffer.getvalue()), np.asarray(picture))
    behind = GOOD + header(9400, 9400) + b"\xff" * 1000
    np.testing.assert_array_equal(decode_png(behind), decode_png(GOOD))


def test_pixels_may_come_in_many_chunks() -> None:
    many = [chunk(b"IDAT", BODY[at : at + 1]) for at in range(8, len(BODY) - 4)]
    assert len(many) > 1000
    np.testing.assert_array_equal(decode_png(file(HEAD, *many, END)), decode_png(GOOD))


def test_alpha_and_colour_may_bring_a_palette_of_suggestions() -> None:
    body = pixels(random_samples(np.random.default_rng(5), SIDE, 8, RGBA), 8)
    head = header(SIDE, SIDE, 8, RGBA)
    np.testing.assert_array_equal(
        decode_png(file(head, COLOURS, body, END)), decode_png(file(head, body, END))
    )
