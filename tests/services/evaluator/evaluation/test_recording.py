"""Champions are compared within a robot, whatever their logs told of it."""

from types import SimpleNamespace
from typing import Any, cast

import pytest

from cspace.worlds import robot_digest
from cspace.worlds.planar.arm import THREE_LINK, PlanarArm
from cspace.worlds.planar.camera import Camera
from cspace.worlds.planar.world import PlanarWorld
from services.evaluator.evaluation import recording
from services.registry.promotion import Decision

TWO, THREE, OTHER_TWO = PlanarWorld(), PlanarWorld(THREE_LINK), PlanarWorld(PlanarArm((1.0, 3.0)))


def decision(version: int, robot: str | None, joints: float) -> Decision:
    metrics = {"joints": joints}
    return Decision(
        "model",
        version,
        promoted=True,
        reasons=(),
        metrics=metrics,
        against=None,
        created_ms=version,
        robot=robot,
    )


@pytest.mark.parametrize(
    ("entry", "world", "same"),
    [
        (decision(1, robot_digest(TWO), 2.0), TWO, True),
        (decision(1, robot_digest(TWO), 2.0), PlanarWorld(sensor=Camera(pixels=32)), True),
        (decision(1, robot_digest(OTHER_TWO), 2.0), TWO, False),
        (decision(1, robot_digest(TWO), 2.0), THREE, False),
        (decision(1, None, 2.0), TWO, True),
        (decision(1, None, 2.0), THREE, False),
    ],
)
def test_a_champion_counts_for_its_own_robot(entry: Decision, world: PlanarWorld, same: bool) -> None:
    assert recording._is_of(entry, world) is same


def test_the_gate_sees_champions_of_the_robot_alone(monkeypatch: pytest.MonkeyPatch) -> None:
    entries = (decision(1, robot_digest(TWO), 2.0), decision(2, robot_digest(OTHER_TWO), 2.0))
    monkeypatch.setattr(recording, "champions", lambda registry, name: entries)
    seen: list[int] = []
    monkeypatch.setattr(
        recording, "judge", lambda candidate, earlier, measures: seen.extend(c.version for c in earlier)
    )
    monkeypatch.setattr(recording, "_gated", lambda evaluation: {})
    evaluation: Any = SimpleNamespace(
        setting=SimpleNamespace(world=TWO),
        validation=SimpleNamespace(reconstruction=SimpleNamespace(precision_gain=None)),
    )
    recording.decide(cast("Any", None), cast("Any", SimpleNamespace(name="model", number=3)), evaluation)
    assert seen == [1]


def test_entries_of_the_log_that_tell_no_robot_are_read() -> None:
    text = decision(1, None, 2.0).to_json().replace(', "robot": null', "")
    assert "robot" not in text
    assert Decision.from_json(text).robot is None
