"""Promotion: what was decided about a version, why, and which version answers from then on.

The log is kept on the versions themselves, one tag ``decision.0001.5f0c2a91`` an entry, holding JSON. It is
append-only: the last part of a tag is random, because the registry has no "set if absent" that would keep two
evaluations of one moment from the same number.
"""

import json
import re
import secrets
from collections.abc import Mapping
from dataclasses import dataclass

from cspace.errors import RegistryError
from services.names import ALIAS_CHAMPION, TAG_ROLLED_BACK
from services.registry.models.port import ModelRegistry, ModelVersion

PREFIX = "decision."
_KEY = re.compile(rf"{re.escape(PREFIX)}(\d+)(?:\.[0-9a-f]+)?", re.ASCII)


@dataclass(frozen=True)
class Decision:
    """What the gate decided about one version.

    Args:
        name: of the model.
        version: its number.
        promoted: whether it becomes the champion.
        reasons: in words, one for each thing that was looked at.
        metrics: the gated metrics, from the validation scenarios.
        against: the champion of that time, None when there was none.
        created_ms: milliseconds since 1970-01-01 UTC.
        robot: digest of the robot that it was judged with; None in entries that are older than digests.
    """

    name: str
    version: int
    promoted: bool
    reasons: tuple[str, ...]
    metrics: Mapping[str, float]
    against: int | None
    created_ms: int
    robot: str | None = None

    def to_json(self) -> str:
        """The form in which the log keeps it."""
        return json.dumps({**vars(self), "metrics": dict(self.metrics)}, sort_keys=True)

    @classmethod
    def from_json(cls, text: str) -> "Decision":
        """Read an entry of the log.

        Raises:
            RegistryError: somebody else wrote it.
        """
        try:
            values = json.loads(text)
            return cls(**{**values, "reasons": tuple(values["reasons"])})
        except (ValueError, TypeError, KeyError, RecursionError) as error:
            raise RegistryError(
                "an entry of the decision log is not readable",
                expected="the JSON of a decision",
                got=text[:100],
                remedy="remove the tag in the registry's page of the version",
            ) from error


def record_decision(registry: ModelRegistry, decision: Decision) -> None:
    """Append a decision to its version's log and, when it promotes, point ``champion`` to the version.

    A version that is promoted again counts as rolled back no longer.

    The log comes first: a champion without a reason must not be, a reason whose alias was not moved is
    recorded again by a second run of the evaluation.

    Raises:
        ModelNotFoundError: there is no such version.
    """
    version = registry.version(decision.name, decision.version)
    number = max((entry[0] for entry in _entries(version)), default=0) + 1
    key = f"{PREFIX}{number:04d}.{secrets.token_hex(4)}"
    registry.set_tags(decision.name, decision.version, {key: decision.to_json()})
    if decision.promoted:
        if TAG_ROLLED_BACK in version.tags:
            registry.remove_tag(decision.name, decision.version, TAG_ROLLED_BACK)
        registry.set_alias(decision.name, ALIAS_CHAMPION, decision.version)


def decisions_of(version: ModelVersion) -> tuple[Decision, ...]:
    """The log of one version, oldest first; entries of one number in the order of their time."""
    entries = [(number, Decision.from_json(text)) for number, text in _entries(version)]
    return tuple(decision for _, decision in sorted(entries, key=lambda one: (one[0], one[1].created_ms)))


def decisions(registry: ModelRegistry, name: str) -> tuple[Decision, ...]:
    """The log of all versions of a model, oldest first."""
    found = [decision for version in reversed(registry.versions(name)) for decision in decisions_of(version)]
    return tuple(sorted(found, key=lambda decision: decision.created_ms))


def champions(registry: ModelRegistry, name: str) -> tuple[Decision, ...]:
    """The decisions that made a champion, oldest first, with the metrics that each was promoted with.

    The gate compares with the best of all of them, so that many small steps down can not add up.
    """
    return tuple(decision for decision in decisions(registry, name) if decision.promoted)


def _entries(version: ModelVersion) -> list[tuple[int, str]]:
    """The log's entries with their numbers."""
    matched = ((_KEY.fullmatch(key), text) for key, text in version.tags.items())
    return [(int(match[1]), text) for match, text in matched if match is not None]
