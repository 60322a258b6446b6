from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import pytest

from cspace.bundle import Bundle
from cspace.errors import ModelNotFoundError, RegistryError
from services.names import ALIAS_CHAMPION
from services.registry.promotion import (
    Decision,
    champions,
    decisions,
    decisions_of,
    record_decision,
)
from tests.bundles import write_tiny_bundle
from tests.fakes.registry import FakeRegistry

NAME = "cspace-sampler"
DECISION = Decision(
    name=NAME,
    version=1,
    promoted=True,
    reasons=("coverage 0.877 is at or above the floor of 0.800", "there is no earlier champion"),
    metrics={"precision": 0.845},
    against=None,
    created_ms=1,
)


@pytest.fixture
def registry(tmp_path: Path) -> FakeRegistry:
    """Three versions of one model."""
    registry = FakeRegistry(tmp_path / "registry")
    bundle = Bundle.load(write_tiny_bundle(tmp_path / "bundle"))
    for run_id in ("a", "b", "c"):
        registry.register(NAME, bundle.folder, run_id, bundle.digest, {})
    return registry


@pytest.mark.parametrize("text", ["", "[]", '{"name": "x"}', "[" * 100_000])
def test_an_entry_that_somebody_else_wrote_is_named(registry: FakeRegistry, text: str) -> None:
    registry.set_tags(NAME, 1, {"decision.0000000000001.beef": text})
    with pytest.raises(RegistryError, match=f"decision log of {NAME}/1"):
        decisions(registry, NAME)


def test_a_promotion_moves_the_champion_and_a_refusal_leaves_it(registry: FakeRegistry) -> None:
    record_decision(registry, DECISION)
    record_decision(registry, replace(DECISION, version=2, against=1))
    assert registry.by_alias(NAME, ALIAS_CHAMPION).number == 2
    record_decision(registry, replace(DECISION, version=3, promoted=False))
    assert registry.by_alias(NAME, ALIAS_CHAMPION).number == 2
    with pytest.raises(ModelNotFoundError):
        record_decision(registry, replace(DECISION, version=9))


def test_the_log_of_the_model_is_in_the_order_of_time(registry: FakeRegistry) -> None:
    second = replace(DECISION, version=3, created_ms=2)
    third = replace(DECISION, version=1, promoted=False, created_ms=3)
    for decision in (DECISION, second, third):
        record_decision(registry, decision)
    assert decisions(registry, NAME) == (DECISION, second, third)
    assert champions(registry, NAME) == (DECISION, second)


def test_of_two_decisions_at_one_moment_both_are_kept(registry: FakeRegistry) -> None:
    for decision in (DECISION, replace(DECISION, promoted=False)):
        record_decision(registry, decision)
    assert len(decisions_of(registry.version(NAME, 1))) == 2


class FullDisk(FakeRegistry):
    """A registry that writes no tags."""

    def __init__(self, inner: FakeRegistry) -> None:
        self.__dict__.update(inner.__dict__)

    def set_tags(self, name: str, number: int, tags: Mapping[str, str]) -> None:
        raise RegistryError("no tag can be written", got=f"{name}/{number}, {sorted(tags)}")


def test_no_champion_is_made_when_the_log_can_not_be_written(registry: FakeRegistry) -> None:
    with pytest.raises(RegistryError, match="no tag"):
        record_decision(FullDisk(registry), DECISION)
    with pytest.raises(ModelNotFoundError):
        registry.by_alias(NAME, ALIAS_CHAMPION)
