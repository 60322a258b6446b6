"""The manifest of a data-set folder: what it holds, how it was made, and the digest of every file."""

import hashlib
import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from cspace.errors import DamagedFileError, DatasetError, ScenarioError
from cspace.world import World
from cspace.worlds import FIRST, read_world

SCHEMA_VERSION = 2
# Told robot and camera of a planar world by themselves; read as that.
_FIRST = 1
MANIFEST_FILE = "manifest.json"
_KEYS = {"schema_version", "world", "counts", "generator", "files", "digest"}
_FIRST_KEYS = _KEYS - {"world"} | {"robot", "camera"}
_OBJECTS = ("counts", "generator", "files")


@dataclass(frozen=True, slots=True)
class Manifest:
    """A data set's description.

    Args:
        world: robot and sensor.
        counts: scenarios, configurations and so on, for people.
        generator: how the data were made; any JSON values.
        files: SHA-256 of each file by its name.
    """

    world: World
    counts: Mapping[str, int]
    generator: Mapping[str, Any]
    files: Mapping[str, str]

    @property
    def digest(self) -> str:
        """One SHA-256 over the world and all files; two data sets with equal content share it."""
        content = {**self._world(), "files": dict(self.files)}
        return hashlib.sha256(json.dumps(content, sort_keys=True).encode()).hexdigest()

    def to_json(self) -> str:
        """The text of ``manifest.json``."""
        content = {
            "schema_version": SCHEMA_VERSION,
            "world": self.world.to_dict(),
            "counts": dict(self.counts),
            "generator": dict(self.generator),
            "files": dict(self.files),
            "digest": self.digest,
        }
        return json.dumps(content, indent=2, sort_keys=True) + "\n"

    @classmethod
    def read(cls, folder: Path) -> "Manifest":
        """Read and check a folder's manifest.

        Raises:
            DatasetError: none there, not JSON, another schema, or keys that do not fit.
            DamagedFileError: its digest is not that of its content.
        """
        path = folder / MANIFEST_FILE
        values = _read_object(path)
        try:
            world = read_world(values["world"])
        except ScenarioError as error:
            raise DatasetError(
                f"{path}: {error.what}", expected=error.expected, got=error.got, remedy=error.remedy
            ) from error
        manifest = cls(world, values["counts"], values["generator"], values["files"])
        if manifest.digest != values["digest"]:
            raise DamagedFileError(f"{path} is damaged", expected=values["digest"], got=manifest.digest)
        return manifest

    def _world(self) -> dict[str, Any]:
        # A world of the first kind without its name, so that the digests of older data sets stay.
        told = self.world.to_dict()
        return {key: value for key, value in told.items() if key != "kind"} if told["kind"] == FIRST else told


def _read_object(path: Path) -> dict[str, Any]:
    """The manifest's JSON with its keys and the kinds of its values checked."""
    try:
        values = json.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise DatasetError(
            "the folder is no data set",
            expected=f"{MANIFEST_FILE} in {path.parent}",
            got=str(error),
            remedy="see docs/data.md for the format, python -m training.datasets import for own data",
        ) from error
    except (ValueError, RecursionError) as error:
        raise DatasetError(f"{path} is not JSON", expected="a manifest", got=str(error)) from error
    if isinstance(values, dict) and values.get("schema_version") == _FIRST and set(values) == _FIRST_KEYS:
        world = {"robot": values.pop("robot"), "camera": values.pop("camera")}
        values |= {"schema_version": SCHEMA_VERSION, "world": world}
    if not isinstance(values, dict) or set(values) != _KEYS or values["schema_version"] != SCHEMA_VERSION:
        raise DatasetError(
            f"{path} is not a manifest of schema {SCHEMA_VERSION}",
            expected=f"the keys {', '.join(sorted(_KEYS))}",
            got=", ".join(sorted(values)) if isinstance(values, dict) else type(values).__name__,
        )
    wrong = [key for key in ("world", *_OBJECTS) if not isinstance(values[key], dict)]
    if wrong or not all(isinstance(digest, str) for digest in values["files"].values()):
        raise DatasetError(
            f"{path} is not a manifest of schema {SCHEMA_VERSION}",
            expected=f"objects as world, {', '.join(_OBJECTS)}, digests as files",
            got=f"something else as {', '.join(wrong) or 'a digest'}",
        )
    return values


def file_digest(path: Path) -> str:
    """SHA-256 of a file, read in blocks."""
    with path.open("rb") as handle:
        return hashlib.file_digest(handle, "sha256").hexdigest()
