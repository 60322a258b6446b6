"""One table of answers that can not be used, each as the script of a server."""

import gzip
import json
import socket
import struct

import numpy as np

from tests.fakes.sample_server import npy
from tests.services.planner.hostile_server import (
    GOOD,
    GOOD_BODY,
    Script,
    ends,
    head,
    plays,
    repeats,
    whole,
)

CHUNKED = {"Transfer_Encoding": "chunked"}
PIECE = b"\0" * 65536
PACKED = gzip.compress(b"\0" * 64 * 2**20)
# Far above any time limit of the tests together, far below each of them alone.
DRIP_S = 0.02
ANSI = "\x1b[2J\x1b[31mred\x07\r\nforged: line\u202egnp.\u2028\x9b\ud800"


def npy_of(header: str, data: bytes = GOOD_BODY[-16:]) -> bytes:
    """A ``.npy`` file of some header."""
    padded = header.encode()
    return b"\x93NUMPY\x01\x00" + struct.pack("<H", len(padded)) + padded + data


def shaped(shape: str, data: bytes = GOOD_BODY[-16:]) -> bytes:
    """A ``.npy`` file that claims a shape."""
    return npy_of(f"{{'descr': '<f4', 'fortran_order': False, 'shape': {shape}, }}".ljust(117) + "\n", data)


def problem(status: str, members: object, **changes: str | None) -> bytes:
    """An answer with a problem document."""
    body = members if isinstance(members, bytes) else json.dumps(members).encode()
    return whole(body, status, Content_Type="application/problem+json", **changes)


def resets(link: socket.socket) -> None:
    """Half an answer, then a reset."""
    link.sendall(whole()[:-8])
    link.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))
    link.close()


ENDLESS: dict[str, Script] = {
    "a body without length": repeats(head() + b"\r\n", PIECE),
    "a chunked body": repeats(head(**CHUNKED) + b"\r\n", b"10000\r\n" + PIECE + b"\r\n"),
    "tiny chunks": repeats(head(**CHUNKED) + b"\r\n", b"1\r\n\0\r\n" * 10_000),
    "a body as long as it says": repeats(head(Content_Length=str(10**15)) + b"\r\n", PIECE),
    "a refusal": repeats(head("422 No", Content_Type="application/problem+json") + b"\r\n", b" " * 65536),
    "a packed body": plays(whole(PACKED, Content_Encoding="gzip")),
    "a header": repeats(head() + b"X-Long: ", PIECE),
    "headers": repeats(head(), b"X-More: 1\r\n" * 5000),
    "a status line": repeats(b"HTTP/1.1 200 ", PIECE),
    "a chunk's extension": repeats(head(**CHUNKED) + b"\r\n1;", b"a" * 65536),
    "trailers": repeats(head(**CHUNKED) + b"\r\n0\r\n", b"X-More: 1\r\n" * 5000),
}

NEVER_DONE: dict[str, Script] = {
    "silence": plays(b""),
    "a dripping status line": repeats(b"HTTP/1.1 200 ", b"O", DRIP_S),
    "dripping headers": repeats(head(), b"X-More: 1\r\n", DRIP_S),
    "a dripping body": repeats(head(Content_Length=str(len(GOOD_BODY))) + b"\r\n\x93", b"\0", 2 * DRIP_S),
    "a dripping problem": repeats(head("422 No", Content_Length="60000") + b"\r\n", b" ", DRIP_S),
    "a flood of 100": repeats(b"", b"HTTP/1.1 100 Continue\r\n\r\n" * 100, DRIP_S / 10),
    "dripping 103": repeats(b"", b"HTTP/1.1 103 Early Hints\r\nX: 1\r\n\r\n", DRIP_S),
    "half a body": plays(whole()[:-1]),
}

BODIES: dict[str, Script] = {
    name: plays(whole(body))
    for name, body in {
        "nothing": b"",
        "text": b"no array",
        "version 2": GOOD_BODY[:6] + b"\x02\x00" + GOOD_BODY[8:],
        "a head longer than the file": b"\x93NUMPY\x01\x00\xff\xff" + GOOD_BODY[10:],
        "a header as deep as the stack": npy_of("(" * 9000 + "\n"),
        "a header of code": shaped("(2, 2, __import__('os'))"),
        "objects": npy_of("{'descr': '|O', 'fortran_order': False, 'shape': (2, 2), }\n"),
        "float64": npy(GOOD.astype(np.float64)),
        "by columns": npy(np.asfortranarray(GOOD)),
        "flat": npy(GOOD[0]),
        "a shape of 30 digits": shaped("(" + "9" * 30 + ", 2)"),
        "a shape of 12 digits": shaped("(1000000000000, 2)"),
        "a shape that multiplies to the size": shaped("(4, 1)"),
        "no joints": shaped("(2, 0)", b""),
        "65 joints": shaped("(2, 65)", b"\0" * 520),
        "fewer rows": npy(GOOD[:1]),
        "cut off": GOOD_BODY[:-1],
        "too long": GOOD_BODY + b"\0",
        "no number": GOOD_BODY[:-4] + struct.pack("<f", float("nan")),
        "a signalling NaN": GOOD_BODY[:-4] + b"\x01\x00\x80\x7f",
        "pi in single precision": npy(np.full((2, 2), np.pi, np.float32)),
    }.items()
}

HEADS: dict[str, Script] = {
    name: plays(whole(**changes))
    for name, changes in {
        "another seed": {"X_Seed": "8"},
        "a seed of 5000 digits": {"X_Seed": "1" * 5000},
        "two seeds": {"X_Seed": "7\r\nX-Seed: 7"},
        "a seed in other digits": {"X_Seed": "\xb2"},
        "no seed": {"X_Seed": None},
        "a shortfall above what was asked for": {"X_Shortfall": "3"},
        "a shortfall below nothing": {"X_Shortfall": "-1"},
        "a shortfall that is none": {"X_Shortfall": "1"},
        "a version that is no number": {"X_Model_Version": "latest"},
        "no name": {"X_Model_Name": None},
        "a name of 60 kB": {"X_Model_Name": "a" * 60_000},
        "an escape in a name": {"X_Model_Name": ANSI[:4]},
        "a digest that is none": {"X_Model_Digest": "ab" * 31 + "zz"},
        "a novelty that is no number": {"X_Novelty": "nan"},
        "a novelty above 1": {"X_Novelty": "1.5"},
        "an acceptance below 0": {"X_Acceptance": "-0.1"},
        "warnings that are no list": {"X_Warnings": '{"code": "x"}'},
        "a warning without words": {"X_Warnings": '[{"code": "x", "pictures": []}]'},
        "warnings of 60 kB": {"X_Warnings": "[" * 60_000},
        "another media type": {"Content_Type": "text/html"},
        "an escape in a media type": {"Content_Type": ANSI[:4]},
        "two lengths": {"Content_Length": "144\r\nContent-Length: 145"},
        "a negative length": {"Content_Length": "-1"},
        "a length of 5000 digits": {"Content_Length": "9" * 5000},
        "a coding of bytes": {"Content_Encoding": "\xff\xfe"},
        "two codings": {"Content_Encoding": "identity, gzip"},
        "a transfer coding": {"Transfer_Encoding": "gzip, chunked"},
        "a NUL": {"X_Other": "a\0b"},
    }.items()
}

STATUSES: dict[str, Script] = {
    "elsewhere that is no address": plays(whole(b"", "308 Moved", Location="http://[::1\x7f:99999999/\xff")),
    "a change of protocol": plays(b"HTTP/1.1 101 Switching Protocols\r\nUpgrade: x\r\n\r\n" + whole()),
    "no content": plays(b"HTTP/1.1 204 No Content\r\n\r\n"),
    "a part": plays(whole(status="206 Partial Content")),
    "a failure": plays(problem("500 Failed", {"title": "The server failed"})),
    "a gateway's time-out": plays(whole(b"<html>", "504 Gateway Timeout", Content_Type="text/html")),
    "status 999": plays(whole(status="999 Odd")),
    "status 99": plays(whole(status="099 Odd")),
    "a wait of 5000 digits": plays(whole(b"", "429 Busy", Retry_After="9" * 5000)),
}

WORDS: dict[str, Script] = {
    "control characters": plays(problem("503 Busy", {"title": ANSI, "detail": ANSI, "type": ANSI})),
    "endless words": plays(problem("503 Busy", {"title": "a" * 20_000, "detail": "b" * 20_000})),
    "a reason of 60 kB": plays(whole(b"", "503 " + "a" * 60_000)),
    "a deep document": plays(problem("503 Busy", b"[" * 60_000)),
    "a number of 60 kB": plays(problem("503 Busy", b'{"title": ' + b"9" * 60_000 + b"}")),
    "words that are no UTF-8": plays(problem("503 Busy", b'{"title": "\xff\xfe\xed\xa0\x80"}')),
    "half characters": plays(problem("503 Busy", b'{"title": "\\ud800", "detail": "\\udfff"}')),
    "a document of no object": plays(problem("503 Busy", [1])),
}

BROKEN: dict[str, Script] = {
    "no HTTP": ends(b"SSH-2.0-OpenSSH_9.2p1\r\n" + bytes(range(256))),
    "another protocol": ends(b"\x16\x03\x01\x02\x00" + b"\0" * 200),
    "HTTP 9": ends(b"HTTP/9.9 200 OK\r\n\r\n"),
    "nothing at all": ends(b""),
    "half a head": ends(head()),
    "half a body": ends(whole()[:-1]),
    "a reset": resets,
    "a header without a colon": ends(b"HTTP/1.1 200 OK\r\nno colon\r\n\r\n"),
    "a header of escapes": ends(b"HTTP/1.1 200 OK\r\n\x1b[31m: \x07\r\n\r\n"),
    "a chunk size that is none": ends(head(**CHUNKED) + b"\r\n-1\r\n\0\r\n0\r\n\r\n"),
    "a chunk size of 30 digits": ends(head(**CHUNKED) + b"\r\n" + b"f" * 30 + b"\r\n"),
    "chunks without an end": ends(head(**CHUNKED) + b"\r\n4\r\n\0\0\0\0\r\n"),
    "folded headers": ends(b"HTTP/1.1 200 OK\r\nX: 1\r\n" + b" \x1b\r\n" * 2000 + b"\r\n"),
}

ATTACKS: dict[str, Script] = {
    f"{family}: {name}": script
    for family, table in {
        "endless": ENDLESS,
        "never done": NEVER_DONE,
        "body": BODIES,
        "head": HEADS,
        "status": STATUSES,
        "words": WORDS,
        "broken": BROKEN,
    }.items()
    for name, script in table.items()
}
