"""The files of a bundle and their sums: read once, verified, and used from memory ever after."""

import hashlib
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
GOLDEN_FILE = "golden.npz"
SUMS_FILE = "SHA256SUMS"
REQUIRED_FILES = (SPEC_FILE, ENCODER_FILE, GENERATOR_FILE, GOLDEN_FILE)
OPTIONAL_FILES = (VALIDITY_FILE, NOVELTY_FILE, MAP_FILE)
KNOWN_FILES = (*REQUIRED_FILES, *OPTIONAL_FILES)

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

    Only plain files straight in the folder are ever opened, and only under the names of the schema, so that
    nothing that a bundle says can point outside of it.

    Raises:
        BundleIntegrityError: a file is missing, extra, a link, changed, or the sums are not readable.
    """
    try:
        present = {entry.name: entry for entry in folder.iterdir()}
        _check_plain(present)
        if SUMS_FILE not in present:
            raise _broken("SHA256SUMS", "missing")
        sums = present.pop(SUMS_FILE).read_bytes()
        listed = _parse_sums(sums)
        _check_names(set(listed), set(present))
        contents = {name: entry.read_bytes() for name, entry in present.items()}
    except OSError as error:
        raise BundleIntegrityError(
            "the bundle cannot be read", expected="a readable folder", got=str(error)
        ) from error
    for name, data in contents.items():
        if hashlib.sha256(data).hexdigest() != listed[name]:
            raise _broken(name, "changed since its sum was written")
    return BundleFiles(contents, hashlib.sha256(sums).hexdigest())


def _check_plain(present: Mapping[str, Path]) -> None:
    for name, entry in present.items():
        if entry.is_symlink() or not entry.is_file():
            raise _broken(name, "not a plain file")


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
