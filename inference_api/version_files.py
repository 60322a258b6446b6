"""What the registry said about a version, kept as JSON beside its bundle for when the registry is away."""

import json
from pathlib import Path

from services.registry.models import ModelVersion


def write_version(path: Path, version: ModelVersion) -> None:
    """Write a version's description, beside and renamed.

    Raises:
        OSError: the file cannot be written.
    """
    values = {
        "name": version.name,
        "number": version.number,
        "run_id": version.run_id,
        "digest": version.digest,
        "aliases": list(version.aliases),
        "tags": dict(version.tags),
        "created_ms": version.created_ms,
    }
    beside = path.with_name(f".{path.name}")
    beside.write_text(json.dumps(values))
    beside.replace(path)


def read_version(path: Path) -> ModelVersion | None:
    """Read a description; None when it is missing or damaged, for it is only a copy."""
    try:
        values = json.loads(path.read_text())
        return ModelVersion(**{**values, "aliases": tuple(values["aliases"])})
    except (OSError, ValueError, TypeError, KeyError):
        return None
