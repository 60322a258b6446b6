"""Multipart forms (RFC 7578) from the bytes of a body, in memory and with a bound on everything but files.

Names and texts are UTF-8 whatever character set a client declares: looking one up would run a codec of its
choice.
"""

import re
from dataclasses import dataclass
from typing import TYPE_CHECKING

from python_multipart.exceptions import FormParserError
from python_multipart.multipart import MultipartParser, parse_options_header

from inference_api.problems import MALFORMED_BODY, RequestError

if TYPE_CHECKING:
    from python_multipart.multipart import MultipartCallbacks

# A form has eight names, one of them repeatable.
MAX_FORM_FIELDS = 2000
MAX_FORM_FILES = 16
MAX_FIELD_BYTES = 64 * 1024
MAX_PART_HEADERS = 8
# A file's name of 255 characters in both of its spellings fits.
MAX_PART_HEADER_BYTES = 4096
# Some may stand in a file's name; each costs a microsecond, in each of many parts.
MAX_SEMICOLONS = 32
_MAX_PARTS = MAX_FORM_FIELDS + MAX_FORM_FILES

# RFC 2046, section 5.1.1.
_BOUNDARY = re.compile(rb"[0-9A-Za-z'()+_,./:=? -]{0,69}[0-9A-Za-z'()+_,./:=?-]", re.ASCII)
_EXTENDED_FILE_NAME = re.compile(rb";[ \t]*filename\*[ \t]*=", re.ASCII | re.IGNORECASE)


@dataclass(frozen=True, slots=True)
class Part:
    """One part of a multipart form.

    Args:
        name: of the field.
        value: a file's bytes, or a plain field's text.
    """

    name: str
    value: bytes | str


def is_boundary(boundary: bytes) -> bool:
    """Whether RFC 2046 allows a boundary."""
    return _BOUNDARY.fullmatch(boundary) is not None


def read_parts(body: bytes, boundary: bytes) -> list[Part]:
    """The parts of a form in their order.

    Args:
        body: all of it.
        boundary: for which :func:`is_boundary` holds.

    Raises:
        RequestError: the form is torn, a part has no name, a text is not UTF-8, or a bound is exceeded.
    """
    _check_marks(body, boundary)
    reader = _Reader()
    parser = MultipartParser(
        boundary,
        reader.callbacks(),
        max_header_count=MAX_PART_HEADERS,
        max_header_size=MAX_PART_HEADER_BYTES,
    )
    try:
        parser.write(body)
    except FormParserError as error:
        raise _malformed(str(error)[:200]) from error
    if not reader.ended:
        raise torn(body)
    return reader.parts


def torn(body: bytes) -> RequestError:
    """The error for a form that does not end."""
    return RequestError(
        MALFORMED_BODY,
        "the multipart body is torn",
        expected="a boundary in the content type and a body that ends with it",
        got=f"{len(body)} bytes without it",
    )


def _check_marks(body: bytes, boundary: bytes) -> None:
    # The parser goes byte by byte through what only begins as a boundary, seconds for 8 MiB of it.
    mark = b"\r\n--" + boundary
    at, count = body.find(mark), 0
    while at >= 0:
        after = at + len(mark)
        follows = body[after : after + 2]
        if follows == b"--":
            return
        count += 1
        if follows != b"\r\n":
            raise _malformed("a boundary that goes on")
        if count > _MAX_PARTS:
            raise _malformed(f"more than {_MAX_PARTS}", expected=f"at most {_MAX_PARTS} parts")
        at = body.find(mark, after)
    if not body.startswith(b"--" + boundary + b"--"):
        raise torn(body)


class _Reader:
    """Collects the parts that the parser finds; it is given all of the body at once."""

    def __init__(self) -> None:
        self.parts: list[Part] = []
        self.ended = False
        self._files = 0
        self._start_part()

    def callbacks(self) -> "MultipartCallbacks":
        return {
            "on_part_begin": self._start_part,
            "on_header_field": self._header_name,
            "on_header_value": self._header_value,
            "on_headers_finished": self._finish_headers,
            "on_part_data": self._data,
            "on_part_end": self._finish_part,
            "on_end": self._end,
        }

    def _start_part(self) -> None:
        self._header, self._disposition, self._header_bytes = b"", b"", 0
        self._name, self._is_file, self._content = "", False, b""

    def _header_name(self, data: bytes, start: int, end: int) -> None:
        self._count_header(end - start)
        self._header = data[start:end].lower()

    def _header_value(self, data: bytes, start: int, end: int) -> None:
        self._count_header(end - start)
        if self._header == b"content-disposition":
            self._disposition = data[start:end]

    def _count_header(self, more: int) -> None:
        self._header_bytes += more
        if self._header_bytes > MAX_PART_HEADER_BYTES:
            raise _malformed("more", expected=f"at most {MAX_PART_HEADER_BYTES} bytes of headers a part")

    def _finish_headers(self) -> None:
        if self._disposition.count(b";") > MAX_SEMICOLONS:
            raise _malformed("more", expected=f"at most {MAX_SEMICOLONS} semicolons in a Content-Disposition")
        _, options = parse_options_header(self._disposition)
        if b"name" not in options:
            raise _malformed("none", expected="a name in the Content-Disposition of each part")
        self._name = _text(options[b"name"])
        self._is_file = b"filename" in options or _EXTENDED_FILE_NAME.search(self._disposition) is not None
        self._files += self._is_file
        if self._files > MAX_FORM_FILES:
            raise _malformed("more", expected=f"at most {MAX_FORM_FILES} files")
        if len(self.parts) - self._files >= MAX_FORM_FIELDS:
            raise _malformed("more", expected=f"at most {MAX_FORM_FIELDS} fields that are no files")

    def _data(self, data: bytes, start: int, end: int) -> None:
        if not self._is_file and end - start > MAX_FIELD_BYTES:
            raise _malformed(
                f"{end - start} bytes", expected=f"at most {MAX_FIELD_BYTES} in a field that is no file"
            )
        self._content = data[start:end]

    def _finish_part(self) -> None:
        self.parts.append(Part(self._name, self._content if self._is_file else _text(self._content)))

    def _end(self) -> None:
        self.ended = True


def _text(data: bytes) -> str:
    try:
        return data.decode("utf-8")
    except UnicodeDecodeError as error:
        raise _malformed("other bytes", expected="names and texts in UTF-8") from error


def _malformed(
    got: str, expected: str = "parts with headers between boundaries, as RFC 7578 has it"
) -> RequestError:
    return RequestError(MALFORMED_BODY, "the multipart body is malformed", expected=expected, got=got)
