"""The files of a bundle and their sums: read once, verified, and used from memory ever after."""

import errno
import hashlib
import os
import re
import stat
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from cspace.errors import BundleIntegrityError

SPEC_FILE = "bundle.json"
ENCODER_FILE = "encoder.onnx"
GENERATOR_FILE = "generator.onnx"
VALIDITY_FILE = "validity.onnx"
NOVELTY_FILE = "novelty.onnx"
MAP_FILE = "map.onnx"
BELIEF_FILE = "belief.onnx"
GOLDEN_FILE = "golden.npz"
SUMS_FILE = "SHA256SUMS"
REQUIRED_FILES = (SPEC_FILE, ENCODER_FILE, GOLDEN_FILE)
OPTIONAL_FILES = (GENERATOR_FILE, VALIDITY_FILE, NOVELTY_FILE, MAP_FILE, BELIEF_FILE)
KNOWN_FILES = (*REQUIRED_FILES, *OPTIONAL_FILES)

# The shipped bundle's largest graph has 1.3 MB, its description 11 kB.
GRAPH_BYTES = 256 * 2**20
TOTAL_BYTES = 512 * 2**20
LIMITS_BYTES = {SPEC_FILE: 2**20, GOLDEN_FILE: 4 * 2**20, SUMS_FILE: 16 * 2**10} | dict.fromkeys(
    (ENCODER_FILE, *OPTIONAL_FILES), GRAPH_BYTES
)

_LINE = re.compile(r"([0-9a-f]{64})  ([A-Za-z0-9._-]+)")


@dataclass(frozen=True, slots=True)
class BundleFiles:
    """A bundle's verified bytes.

    Args:
        contents: file name to bytes, ``SHA256SUMS`` left out.
        digest: SHA-256 of ``SHA256SUMS``, which names the bundle.
    """

    contents: Mapping[str, bytes]
    digest: str


def sums_of(contents: Mapping[str, bytes]) -> bytes:
    """``SHA256SUMS`` for the given files, in the form that ``sha256sum --check`` reads."""
    lines = [f"{hashlib.sha256(contents[name]).hexdigest()}  {name}\n" for name in sorted(contents)]
    return "".join(lines).encode()


def read_files(folder: Path) -> BundleFiles:
    """Read a bundle's folder and hold it against its ``SHA256SUMS``.

    Only plain files straight in the folder are ever opened, only under the names of the schema, and no more
    of them is read than a bundle may hold. What was opened is what is looked at: nothing that is exchanged
    meanwhile is followed.
    """
    try:
        place = os.open(folder, os.O_RDONLY | os.O_DIRECTORY | os.O_CLOEXEC)
        try:
            contents = _read_all(place)
        finally:
            os.close(place)
    except (OSError, ValueError) as error:
        raise BundleIntegrityError(
            "the bundle cannot be read",
            expected="a readable folder",
            got=getattr(error, "strerror", None) or type(error).__name__,
        ) from error
    sums = contents.pop(SUMS_FILE)
    listed = _parse_sums(sums)
    _check_names(set(listed), set(contents))
    for name, data in contents.items():
        if hashlib.sha256(data).hexdigest() != listed[name]:
            raise _broken(name, "changed since its sum was written")
    return BundleFiles(contents, hashlib.sha256(sums).hexdigest())


def _read_all(place: int) -> dict[str, bytes]:
    """Every file of an open folder, ``SHA256SUMS`` first, within the limits of each and of all."""
    names = set()
    with os.scandir(place) as entries:
        for entry in entries:
            names.add(entry.name)
            # The first that does not belong ends it, however many follow.
            if entry.name not in LIMITS_BYTES:
                raise _broken(_shown(entry.name), "not part of a bundle")
    if SUMS_FILE not in names:
        raise _broken(SUMS_FILE, "missing")
    left = TOTAL_BYTES
    contents: dict[str, bytes] = {}
    for name in (SUMS_FILE, *(known for known in KNOWN_FILES if known in names)):
        contents[name] = _read(place, name, min(LIMITS_BYTES[name], left))
        left -= len(contents[name])
    return contents


def _read(place: int, name: str, limit_bytes: int) -> bytes:
    """A plain file of an open folder; opening neither follows a link nor waits for a pipe's other end."""
    flags = os.O_RDONLY | os.O_NOFOLLOW | os.O_NONBLOCK | os.O_CLOEXEC
    try:
        opened = os.open(name, flags, dir_fd=place)
    except OSError as error:
        # A link, or a socket.
        if error.errno in (errno.ELOOP, errno.ENXIO):
            raise _broken(name, "not a plain file") from error
        raise
    try:
        found = os.fstat(opened)
        if not stat.S_ISREG(found.st_mode):
            raise _broken(name, "not a plain file")
        if found.st_size > limit_bytes:
            raise _broken(name, f"{found.st_size} bytes, more than {limit_bytes}")
        with os.fdopen(opened, "rb", closefd=False) as file:
            data = file.read(found.st_size + 1)
    finally:
        os.close(opened)
    if len(data) != found.st_size:
        raise _broken(name, "changed while it was read")
    return data


def _shown(name: str) -> str:
    return name.encode("utf-8", "backslashreplace").decode()[:100]


def _parse_sums(sums: bytes) -> dict[str, str]:
    listed: dict[str, str] = {}
    for line in sums.decode("ascii", errors="replace").splitlines():
        match = _LINE.fullmatch(line)
        if match is None or match[2] in listed:
            raise _broken(SUMS_FILE, f"not readable at {line[:100]!r}")
        listed[match[2]] = match[1]
    return listed


def _check_names(listed: set[str], present: set[str]) -> None:
    problems = {
        "missing": sorted((listed | set(REQUIRED_FILES)) - present),
        "not in SHA256SUMS": sorted(present - listed),
        "not part of a bundle": sorted((present | listed) - set(KNOWN_FILES)),
    }
    for problem, names in problems.items():
        if names:
            raise _broken(", ".join(names), problem)


def _broken(name: str, problem: str) -> BundleIntegrityError:
    perhaps = ", ".join(OPTIONAL_FILES)
    return BundleIntegrityError(
        f"{name}: {problem}",
        expected=f"{', '.join(REQUIRED_FILES)}, perhaps {perhaps}, as SHA256SUMS lists them",
        remedy="fetch the bundle again, or export it again",
    )
