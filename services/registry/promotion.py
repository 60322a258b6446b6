"""Which version answers: the log of decisions, and what people do with versions by hand.

The log is kept on the versions themselves, one tag ``decision.<ms since 1970>.<random>`` an entry, holding
JSON. It is append-only: the last part keeps two evaluations of one moment apart. Every move of the champion
by hand is a decision as the evaluator's are, with the words ``by hand`` among its reasons.
"""

import secrets
import tempfile
import time
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path

from pydantic import TypeAdapter, ValidationError

from cspace.bundle import load_verified
from cspace.bundle.files import read_files
from cspace.bundle.spec import BundleSpec
from cspace.errors import BundleIntegrityError, ConfigError, ModelNotFoundError, RegistryError
from cspace.worlds import robot_digest
from services.names import (
    ALIAS_CHALLENGER,
    ALIAS_CHAMPION,
    EXPERIMENT,
    TAG_ROBOT,
    TAG_ROLLED_BACK,
    TAG_SIGNATURE,
    is_kept,
    is_own,
    model_name,
)
from services.registry import signing
from services.registry.entities import ModelVersion
from services.registry.models import ModelRegistry
from services.registry.tracking import Tracking

PREFIX = "decision."


@dataclass(frozen=True)
class Decision:
    """What the gate decided about one version.

    ``metrics`` are the gated ones of the validation scenarios, ``against`` is the champion of that time, and
    ``robot`` the digest of the robot of the evaluation: champions of others are not compared.
    """

    name: str
    version: int
    promoted: bool
    reasons: tuple[str, ...]
    metrics: Mapping[str, float]
    against: int | None
    created_ms: int
    robot: str | None = None


_DECISION = TypeAdapter(Decision)


def record_decision(registry: ModelRegistry, decision: Decision) -> None:
    """Append a decision to its version's log and, when it promotes, point ``champion`` to the version.

    A version that is promoted again counts as rolled back no longer.

    The log comes first: a champion without a reason must not be, a reason whose alias was not moved is
    recorded again by a second run of the evaluation.
    """
    key = f"{PREFIX}{decision.created_ms:013d}.{secrets.token_hex(4)}"
    registry.set_tags(decision.name, decision.version, {key: _DECISION.dump_json(decision).decode()})
    if decision.promoted:
        registry.remove_tag(decision.name, decision.version, TAG_ROLLED_BACK)
        registry.set_alias(decision.name, ALIAS_CHAMPION, decision.version)


def decisions_of(version: ModelVersion) -> tuple[Decision, ...]:
    """The log of one version, oldest first."""
    texts = [text for key, text in version.tags.items() if key.startswith(PREFIX)]
    try:
        found = [_DECISION.validate_json(text) for text in texts]
    except ValidationError as error:
        raise RegistryError(
            f"an entry in the decision log of {version} is not readable",
            expected="the JSON of a decision",
            got=f"{error.errors()[0]['input']}"[:100],
            remedy="remove the tag in the registry's page of the version",
        ) from error
    return tuple(sorted(found, key=lambda decision: decision.created_ms))


def decisions(registry: ModelRegistry, name: str) -> tuple[Decision, ...]:
    """The log of all versions of a model, oldest first."""
    found = [decision for version in reversed(registry.versions(name)) for decision in decisions_of(version)]
    return tuple(sorted(found, key=lambda decision: decision.created_ms))


def champions(registry: ModelRegistry, name: str) -> tuple[Decision, ...]:
    """The decisions that made a champion, oldest first, with the metrics that each was promoted with.

    The gate compares with the best of all of them, so that many small steps down can not add up.
    """
    return tuple(decision for decision in decisions(registry, name) if decision.promoted)


def utc(moment_ms: int) -> str:
    """A moment as people read it."""
    return datetime.fromtimestamp(moment_ms / 1000, UTC).strftime("%Y-%m-%d %H:%M:%S UTC")


def promote(registry: ModelRegistry, version: ModelVersion, reason: str) -> Decision:
    """Make a version the champion, whatever the gate decided; its bundle is verified first."""
    decision = _by_hand(registry, version, reason)
    record_decision(registry, decision)
    return decision


def roll_back(registry: ModelRegistry, name: str, reason: str) -> Decision:
    """Make the version champion that was it before the present one.

    The one that is left bears the date in its tag ``rolled_back`` until it is promoted again: no candidate
    is held against it.
    """
    present = registry.by_alias(name, ALIAS_CHAMPION).number
    there = {version.number: version for version in registry.versions(name)}
    row = (there.get(decision.version) for decision in champions(registry, name))
    earlier = [one for one in row if one and one.number != present and TAG_ROLLED_BACK not in one.tags]
    if not earlier:
        raise ModelNotFoundError(
            f"{name} cannot be rolled back",
            expected="a champion before the present one",
            got=f"version {present} alone",
            remedy="promote another version, or delete this one and the shipped model answers",
        )
    decision = _by_hand(registry, earlier[-1], f"rolled back from {present}: {reason}")
    # Before the alias moves: whoever repeats a command that was cut short must not step back twice.
    now = datetime.now(UTC).isoformat(timespec="seconds")
    registry.set_tags(name, present, {TAG_ROLLED_BACK: now})
    record_decision(registry, decision)
    return decision


def delete(registry: ModelRegistry, version: ModelVersion) -> None:
    """Delete a version that no alias names."""
    if version.aliases:
        raise ConfigError(
            f"{version} is in use",
            expected="a version without aliases",
            got=", ".join(version.aliases),
            remedy=f"promote another version, or roll back; then delete {version}",
        )
    registry.delete(version.name, version.number)


def sign(registry: ModelRegistry, version: ModelVersion, private_key: Path) -> None:
    """Sign a version with its bundle as it is in the registry."""
    with tempfile.TemporaryDirectory(prefix="cspace-sign-") as temporary:
        folder = registry.download(version, Path(temporary) / "bundle")
        digest = read_files(folder).digest
        if digest != version.digest:
            raise BundleIntegrityError(
                "the bundle is another one", expected=f"the digest {version.digest}", got=digest
            )
        registry.set_tags(
            version.name, version.number, {TAG_SIGNATURE: signing.sign(folder, version, private_key)}
        )


def import_version(registry: ModelRegistry, tracking: Tracking, folder: Path, name: str) -> ModelVersion:
    """Register a bundle as the challenger; once, if repeated."""
    bundle = load_verified(folder)
    _require_name(registry, name, bundle.spec)
    key = f"import/{name}/{bundle.digest}"
    title = f"import {bundle.digest[:8]}"
    with tracking.start(EXPERIMENT, title, tags={"imported": "true"}, key=key) as run:
        return registry.register(name, folder, run.run_id, bundle.digest, {}, alias=ALIAS_CHALLENGER)


def _require_name(registry: ModelRegistry, name: str, spec: BundleSpec) -> None:
    """Refuse a name that is kept for another robot, or under which the registry has another's versions."""
    if is_own(name, spec.world):
        return
    digest = robot_digest(spec.world)
    other = next((one for one in registry.versions(name) if one.tags.get(TAG_ROBOT, digest) != digest), None)
    if other is None and not is_kept(name):
        return
    known = "" if other is None else f", and {other} is of robot {other.tags[TAG_ROBOT][:8]}"
    raise ConfigError(
        "the model's name is another robot's",
        expected=f"a name whose models are of robot {digest[:8]}",
        got=f"{name}{known}",
        remedy=f"import it as {model_name(spec.world, path=spec.kind == 'path')}, or under another name",
    )


def _by_hand(registry: ModelRegistry, version: ModelVersion, reason: str) -> Decision:
    """The decision that makes a version the champion, after its bundle was read and replayed."""
    with tempfile.TemporaryDirectory(prefix="cspace-promote-") as folder:
        bundle = registry.download(version, Path(folder) / "bundle")
        world = load_verified(bundle, version.digest).spec.world
    decisions, champion = decisions_of(version), None
    with suppress(ModelNotFoundError):
        champion = registry.by_alias(version.name, ALIAS_CHAMPION).number
    return Decision(
        version.name,
        version.number,
        promoted=True,
        reasons=(f"by hand: {reason}",),
        metrics=decisions[-1].metrics if decisions else {},
        against=champion,
        created_ms=time.time_ns() // 1_000_000,
        robot=robot_digest(world),
    )
