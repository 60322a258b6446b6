"""What people do with registered versions by hand: promote, roll back, delete, export, import.

Every move of the champion is a decision in its version's log (:mod:`services.registry.promotion`), as the
evaluator's are, with the words ``by hand`` among its reasons.
"""

import tempfile
import time
from collections.abc import Mapping
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from cspace.bundle.spec import BundleSpec
from cspace.bundle.verification import verify
from cspace.errors import ConfigError, ModelNotFoundError
from cspace.files import read_bounded, replacing, write_json
from cspace.strict_json import parse_json
from cspace.worlds import robot_digest
from services.names import (
    ALIAS_CHALLENGER,
    ALIAS_CHAMPION,
    EXPERIMENT,
    TAG_DIGEST,
    TAG_ROBOT,
    TAG_ROLLED_BACK,
    is_kept,
    is_own,
    model_name,
    names_beside,
)
from services.registry.models.mlflow_model import read_spec
from services.registry.models.port import ModelRegistry, ModelVersion
from services.registry.promotion import Decision, champions, decisions_of, record_decision
from services.registry.tracking.port import Tracking

BUNDLE_FOLDER, RECORD = "bundle", "version.json"
BY_HAND, STEP_BACK = "by hand", "rolled back from"
_MAX_RECORD_BYTES = 2**20
ROLLED_BACK = f"{BY_HAND}: {STEP_BACK}"


def promote(registry: ModelRegistry, version: ModelVersion, reason: str) -> Decision:
    """Make a version the champion, whatever the gate thinks of it; its bundle is read and replayed first.

    Args:
        registry: holds it.
        version: which.
        reason: is kept with the decision.

    Raises:
        BundleError: its bundle is damaged or answers otherwise here.
        RegistryError: the registry refuses.
    """
    decision = _by_hand(registry, version, reason)
    record_decision(registry, decision)
    return decision


def roll_back(registry: ModelRegistry, name: str, reason: str) -> Decision:
    """Make the version champion that was it before the present one.

    The one that is left bears the date in its tag ``rolled_back`` until it is promoted again: no candidate
    is held against it.

    Raises:
        ModelNotFoundError: there is no champion, or there was none before it that still exists.
    """
    present = registry.by_alias(name, ALIAS_CHAMPION).number
    there = {version.number: version for version in registry.versions(name)}
    row: list[int] = []
    for decision in champions(registry, name):
        # A step back takes off the row what it left behind.
        if decision.reasons[0].startswith(ROLLED_BACK) and decision.version in row:
            del row[len(row) - row[::-1].index(decision.version) :]
        else:
            row.append(decision.version)
    earlier = [number for number in row if number != present and number in there]
    if not earlier:
        raise ModelNotFoundError(
            f"{name} cannot be rolled back",
            expected="a champion before the present one",
            got=f"version {present} alone",
            remedy="promote another version, or delete this one and the shipped model answers",
        )
    decision = _by_hand(registry, there[earlier[-1]], f"{STEP_BACK} {present}: {reason}")
    # Before the alias moves: whoever repeats a command that was cut short must not step back twice.
    now = datetime.now(UTC).isoformat(timespec="seconds")
    registry.set_tags(name, present, {TAG_ROLLED_BACK: now})
    record_decision(registry, decision)
    return decision


def delete(registry: ModelRegistry, version: ModelVersion) -> None:
    """Delete a version that no alias names.

    Raises:
        ConfigError: an alias names it.
        ModelNotFoundError: there is no such version.
    """
    if version.aliases:
        raise ConfigError(
            f"{version} is in use",
            expected="a version without aliases",
            got=", ".join(version.aliases),
            remedy=f"promote another version, or roll back; then delete {version}",
        )
    registry.delete(version.name, version.number)


def export_version(registry: ModelRegistry, version: ModelVersion, folder: Path) -> Path:
    """Write a version's bundle, tags and decisions into a new folder, whole or not at all.

    Raises:
        ConfigError: the folder exists.
        StorageError: it cannot be written.
    """
    if folder.exists():
        raise ConfigError("the export's folder exists", expected="a new folder", got=str(folder))
    with replacing(folder, "the export") as beside:
        beside.mkdir(parents=True)
        registry.download(version, beside / BUNDLE_FOLDER)
        record = {key: value for key, value in vars(version).items() if key != "aliases"}
        write_json(beside / RECORD, {**record, "tags": dict(version.tags)}, indent=2)
    return folder


def import_version(registry: ModelRegistry, tracking: Tracking, folder: Path, name: str) -> ModelVersion:
    """Register what :func:`export_version` wrote, or a bundle alone, as the challenger; once, if repeated.

    Raises:
        BundleError: the bundle is damaged or answers otherwise here.
        ConfigError: the folder holds neither, or the name is another robot's.
    """
    bundle = folder / BUNDLE_FOLDER if (folder / BUNDLE_FOLDER).is_dir() else folder
    digest = verify(bundle)
    _require_name(registry, name, read_spec(bundle, digest))
    tags = _tags(folder / RECORD)
    key = f"import/{name}/{digest}"
    with tracking.start(EXPERIMENT, f"import {digest[:8]}", tags={"imported": "true"}, key=key) as run:
        return registry.register(name, bundle, run.run_id, digest, tags, alias=ALIAS_CHALLENGER)


def _require_name(registry: ModelRegistry, name: str, spec: BundleSpec) -> None:
    """Refuse a name that is kept for another robot, or under which the registry has another's versions."""
    if is_own(name, spec.world):
        return
    digest = robot_digest(spec.world)
    held = (version for model in names_beside(name) for version in registry.versions(model))
    other = next((one for one in held if one.tags.get(TAG_ROBOT, digest) != digest), None)
    if other is None and not is_kept(name):
        return
    told = "" if other is None else f", and {other} is of robot {other.tags[TAG_ROBOT][:8]}"
    raise ConfigError(
        "the model's name is another robot's",
        expected=f"a name whose models are of robot {digest[:8]}",
        got=f"{name}{told}",
        remedy=f"import it as {model_name(spec.world, path=spec.kind == 'path')}, or under another name",
    )


def _tags(record: Path) -> Mapping[str, str]:
    """Of the exported version, the decisions about it elsewhere left out: they compare with others."""
    if not record.exists():
        return {}
    data = read_bounded(record, _MAX_RECORD_BYTES, ConfigError)
    try:
        values: Any = parse_json(data)
        tags = {str(key): str(value) for key, value in values["tags"].items()}
    except (ValueError, LookupError, TypeError, AttributeError) as error:
        raise ConfigError(
            f"{record} is not readable", expected="what `export` wrote", got=type(error).__name__
        ) from error
    left_out = (TAG_DIGEST, TAG_ROLLED_BACK)
    return {
        key: value for key, value in tags.items() if not key.startswith("decision.") and key not in left_out
    }


def _by_hand(registry: ModelRegistry, version: ModelVersion, reason: str) -> Decision:
    """The decision that makes a version the champion, after its bundle was read and replayed."""
    with tempfile.TemporaryDirectory(prefix="cspace-promote-") as folder:
        bundle = registry.download(version, Path(folder) / BUNDLE_FOLDER)
        spec = read_spec(bundle, verify(bundle, version.digest))
    judged = decisions_of(version)
    return Decision(
        version.name,
        version.number,
        promoted=True,
        reasons=(f"{BY_HAND}: {reason}",),
        metrics=judged[-1].metrics if judged else {},
        against=_champion(registry, version.name),
        created_ms=time.time_ns() // 1_000_000,
        robot=robot_digest(spec.world),
    )


def _champion(registry: ModelRegistry, name: str) -> int | None:
    try:
        return registry.by_alias(name, ALIAS_CHAMPION).number
    except ModelNotFoundError:
        return None
