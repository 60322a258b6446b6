"""The files of a bundle and their sums: read once, verified, and used from memory ever after."""

import hashlib
import os
import re
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
    """A bundle's verified bytes."""

    contents: Mapping[str, bytes]  # file name to bytes, `SHA256SUMS` left out
    digest: str  # SHA-256 of `SHA256SUMS`, which names the bundle


def sums_of(contents: Mapping[str, bytes]) -> bytes:
    """``SHA256SUMS`` for the given files, in the form that ``sha256sum --check`` reads."""
    lines = [f"{hashlib.sha256(contents[name]).hexdigest()}  {name}\n" for name in sorted(contents)]
    return "".join(lines).encode()


def read_files(folder: Path) -> BundleFiles:
    """Read a bundle's folder and hold it against its ``SHA256SUMS``.

    Only plain files straight in the folder are read, only under the names of the schema, and no more of them
    than a bundle may hold.
    """
    try:
        contents = _read_all(folder)
    except (OSError, ValueError) as error:
        raise BundleIntegrityError(
            "the bundle cannot be read",
            expected="a readable folder",
            got=getattr(error, "strerror", None) or type(error).__name__,
        ) from error
    if SUMS_FILE not in contents:
        raise _broken(SUMS_FILE, "missing")
    sums = contents.pop(SUMS_FILE)
    listed = _parse_sums(sums)
    _check_names(set(listed), set(contents))
    for name, data in contents.items():
        if hashlib.sha256(data).hexdigest() != listed[name]:
            raise _broken(name, "changed since its sum was written")
    return BundleFiles(contents, hashlib.sha256(sums).hexdigest())


def _read_all(folder: Path) -> dict[str, bytes]:
    left, names = TOTAL_BYTES, []
    with os.scandir(folder) as entries:
        for entry in entries:
            if entry.name not in LIMITS_BYTES:
                shown = entry.name.encode("utf-8", "backslashreplace").decode()[:100]
                raise _broken(shown, "not part of a bundle")
            if not entry.is_file(follow_symlinks=False):
                raise _broken(entry.name, "not a plain file")
            size = entry.stat().st_size
            left -= size
            if size > LIMITS_BYTES[entry.name] or left < 0:
                raise _broken(entry.name, f"{size} bytes, more than a bundle may hold")
            names.append(entry.name)
    return {name: (folder / name).read_bytes() for name in names}


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
