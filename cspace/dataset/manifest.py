"""The manifest of a data-set folder: what it holds, how it was made, and the digest of every file."""

import hashlib
import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

from cspace.errors import DamagedFileError, DatasetError, ScenarioError
from cspace.files import read_bounded
from cspace.strict_json import json_text, parse_json, read_mapping, read_members, read_object, written
from cspace.world import World
from cspace.worlds import FIRST, read_world

SCHEMA_VERSION = 2
MANIFEST_FILE = "manifest.json"
# Of a data set with some hundred files it has some 100 KiB.
MAX_MANIFEST_BYTES = 16 * 2**20
_KEYS = {"schema_version", "world", "counts", "generator", "files", "digest"}


@dataclass(frozen=True, slots=True)
class Manifest:
    """A data set's description.

    Args:
        world: robot and sensor.
        counts: scenarios, configurations and so on, for people.
        generator: how the data were made; any JSON values.
        files: SHA-256 of each file by its name.
    """

    world: Annotated[World, read_world]
    counts: Mapping[str, int]
    generator: Mapping[str, Any]
    files: Mapping[str, str]

    @property
    def digest(self) -> str:
        """One SHA-256 over the world and all files; two data sets with equal content share it."""
        content = {**self._world(), "files": dict(self.files)}
        return hashlib.sha256(json.dumps(content, sort_keys=True).encode()).hexdigest()

    def to_json(self) -> str:
        """The text of ``manifest.json``.

        Raises:
            DatasetError: the generator holds something that JSON does not.
        """
        content = written(self) | {"schema_version": SCHEMA_VERSION, "digest": self.digest}
        return json_text(content, MANIFEST_FILE, "generator", DatasetError)

    @classmethod
    def read(cls, folder: Path) -> "Manifest":
        """Read and check a folder's manifest.

        Raises:
            DatasetError: none there, not JSON, another schema, or keys that do not fit.
            DamagedFileError: its digest is not that of its content.
        """
        path = folder / MANIFEST_FILE
        members = _read_members(path)
        digest = members.pop("digest")
        try:
            manifest = read_object(cls, members, str(path), DatasetError)
        except ScenarioError as error:
            raise DatasetError(
                f"{path}: {error.what}", expected=error.expected, got=error.got, remedy=error.remedy
            ) from error
        if manifest.digest != digest:
            raise DamagedFileError(f"{path} is damaged", expected=str(digest)[:200], got=manifest.digest)
        return manifest

    def _world(self) -> dict[str, Any]:
        # A world of the first kind without its name, so that the digests of older data sets stay.
        told = self.world.to_dict()
        return {key: value for key, value in told.items() if key != "kind"} if told["kind"] == FIRST else told


def _read_members(path: Path) -> dict[str, Any]:
    """The members of the manifest's JSON as this schema has them, without their version."""
    remedy = "see docs/data.md for the format, python -m training.datasets import for own data"
    data = read_bounded(path, MAX_MANIFEST_BYTES, DatasetError, remedy=remedy)
    try:
        values = parse_json(data, whole=int)
    except ValueError as error:
        raise DatasetError(f"{path} is not JSON", expected="a manifest", got=str(error)[:200]) from error
    version = read_mapping(values, str(path), DatasetError).get("schema_version")
    if version != SCHEMA_VERSION:
        raise DatasetError(
            f"{path} is of another schema",
            expected=f"schema_version {SCHEMA_VERSION}",
            got=repr(version)[:200],
            remedy="generate or import the data again with this release",
        )
    members = read_members(values, _KEYS, str(path), DatasetError)
    del members["schema_version"]
    return members


def file_digest(path: Path) -> str:
    """SHA-256 of a file, read in blocks."""
    with path.open("rb") as handle:
        return hashlib.file_digest(handle, "sha256").hexdigest()
