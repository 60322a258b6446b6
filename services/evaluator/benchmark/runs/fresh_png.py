"""The same picture as another file, so that a server that remembers pictures has to work for it again."""

import struct
import zlib

from cspace.view_file import is_view, pack_view, unpack_view

_END = struct.pack(">I", 0) + b"IEND" + struct.pack(">I", zlib.crc32(b"IEND"))


def fresh_picture(file: bytes, note: str) -> bytes:
    """:func:`fresh_png` of a PNG file, or of the first picture of a view.

    Raises:
        ValueError: a picture does not end as a PNG file does.
        ImageError: the view is none.
    """
    if not is_view(file):
        return fresh_png(file, note)
    view = unpack_view(file)
    pictures = [fresh_png(view.pictures[0], note), *view.pictures[1:]]
    return pack_view(pictures, view.cameras, view.state, view.depth_scale_m)


def fresh_png(png: bytes, note: str) -> bytes:
    """A PNG file with a note in front of its end; the pixels stay the same.

    Raises:
        ValueError: the bytes do not end as a PNG file does.
    """
    if not png.endswith(_END):
        raise ValueError("a PNG file ends with an empty IEND chunk")
    content = b"tEXtComment\0" + note.encode("latin-1")
    chunk = struct.pack(">I", len(content) - 4) + content + struct.pack(">I", zlib.crc32(content))
    return png.removesuffix(_END) + chunk + _END
