"""Data sets of what became of plans."""

from pathlib import Path

import numpy as np
import pytest

from cspace.dataset import Dataset
from cspace.errors import DatasetError
from cspace.files import encode_png
from cspace.worlds import examples, robot_digest
from tests.bundles import picture
from tests.fakes.registry import FakeTracking
from tests.training.data.test_known_plans import uploaded
from training.data import outcomes
from training.data.outcomes import KnownPlan, import_outcomes

WORLD = examples()["two-link"]
PATH = np.array([[0.0, 0.0], [1.0, 0.0]])


def plan(seed: int, collided_at: float | None = None) -> KnownPlan:
    return KnownPlan(encode_png(picture(seed)), PATH, collided_at, f"run-{seed}")


def imported(
    monkeypatch: pytest.MonkeyPatch, folder: Path, *plans: KnownPlan, site: str | None = None
) -> tuple[list[object], Dataset]:
    asked: list[object] = []

    def known(*given: object) -> list[KnownPlan]:
        asked.extend(given[1:])
        return list(plans)

    monkeypatch.setattr(outcomes, "known_plans", known)
    return asked, import_outcomes(folder / "data", world=WORLD, tracking=FakeTracking(), site=site)


def test_a_picture_is_a_scenario_with_the_configurations_of_all_its_plans(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    learned = [seed for seed in range(12) if not plan(seed).held_out][:2]
    left_out = next(seed for seed in range(50) if plan(seed).held_out)
    first, second = learned
    asked, data = imported(
        monkeypatch, tmp_path, plan(first), plan(left_out), plan(second), plan(first, 0.5), site="lab"
    )
    assert asked == [robot_digest(WORLD), "lab"]
    assert data.scenario_count == 2
    np.testing.assert_array_equal(data.images[0], WORLD.read_picture(encode_png(picture(first))))
    # Eleven of the free plan, and those up to a tenth of a radian before the collision of the other.
    assert [len(data.free_of(row)) for row in (0, 1)] == [11 + 4, 11]
    np.testing.assert_allclose(data.collision_of(0), [[0.5, 0.0]], atol=1e-6)
    assert len(data.collision_of(1)) == 0
    batches = {f"run-{first}": 2, f"run-{second}": 1}
    assert data.manifest.generator["outcomes"] == batches


def test_without_plans_there_is_no_data_set_and_the_way_to_some_is_named(tmp_path: Path) -> None:
    with pytest.raises(DatasetError, match=r"plans to train on.*at lab; plan with keep, report"):
        import_outcomes(tmp_path / "data", world=WORLD, tracking=uploaded(tmp_path), site="lab")
    assert not (tmp_path / "data").exists()
