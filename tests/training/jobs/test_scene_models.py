"""Scene models as versions: registered once, champion by what was measured, fetched as registered."""

from pathlib import Path

import pytest

from cspace.errors import BundleIntegrityError, InputError, ModelNotFoundError
from services.names import SCENE_MODEL_FILE, SCENE_MODEL_NAME, SCENE_MODELS_EXPERIMENT
from tests.fakes.registry import FakeRegistry, FakeTracking
from training.scene_model import fetch, register


class Kept:
    """A tracking server and its registry."""

    def __init__(self, folder: Path) -> None:
        self.folder, self.tracking = folder, FakeTracking()
        self.registry = FakeRegistry(folder / "registry", self.tracking.runs)

    def register(
        self, weights: bytes, accuracy: float = 0.9, false_free: float = 0.02, arm: str = "ur5"
    ) -> tuple[str, ...]:
        """The version and its aliases."""
        file = self.folder / SCENE_MODEL_FILE
        file.write_bytes(weights)
        figures = {
            "panda": {"accuracy": 0.9, "false_free_above_0.9": 0.02},
            arm: {"accuracy": accuracy, "false_free_above_0.9": false_free},
        }
        version = register(file, figures, {"steps": 5}, self.tracking, self.registry)
        return str(version), *version.aliases

    def fetch(self, reference: str) -> bytes:
        fetch(reference, self.folder / "fetched", self.tracking, self.registry)
        return (self.folder / "fetched").read_bytes()


@pytest.fixture
def kept(tmp_path: Path) -> Kept:
    return Kept(tmp_path)


def test_the_first_and_each_better_one_is_the_champion(kept: Kept) -> None:
    assert kept.register(b"one") == ("scene-model/1", "champion")
    assert kept.register(b"two", accuracy=0.91) == ("scene-model/2", "champion")
    # Less accurate; and more accurate, but more of what passes is in collision.
    assert kept.register(b"three", accuracy=0.905) == ("scene-model/3", "challenger")
    assert kept.register(b"four", accuracy=0.95, false_free=0.026) == ("scene-model/4", "challenger")
    assert kept.fetch("scene-model") == kept.fetch("scene-model@champion") == b"two"
    assert kept.fetch("scene-model/1") == b"one"
    (run,) = [run for run in kept.tracking.runs.values() if "two" in str(run.artifacts)]
    assert (run.experiment, run.history["ur5.accuracy"]) == (SCENE_MODELS_EXPERIMENT, [(0, 0.91)])


def test_an_arm_that_the_champion_was_not_measured_with_decides_nothing(kept: Kept) -> None:
    assert kept.register(b"one") == ("scene-model/1", "champion")
    assert kept.register(b"two", accuracy=0.99, false_free=0.5, arm="xarm7") == (
        "scene-model/2",
        "challenger",
    )


def test_the_same_weights_are_registered_once_and_stay_the_champion(kept: Kept) -> None:
    for _ in range(2):
        assert kept.register(b"one") == ("scene-model/1", "champion")
    assert len(kept.registry.versions(SCENE_MODEL_NAME)) == 1


def test_what_cannot_be_fetched_is_refused_and_leaves_the_file(kept: Kept) -> None:
    kept.register(b"one")
    kept.fetch("scene-model/1")
    with pytest.raises(InputError, match="no scene model"):
        kept.fetch("panda-sampler@champion")
    with pytest.raises(ModelNotFoundError):
        kept.fetch("scene-model/7")
    (run,) = kept.tracking.runs.values()
    run.artifacts["scene_model.safetensors"] = b"another"
    with pytest.raises(BundleIntegrityError, match="not those that were registered"):
        kept.fetch("scene-model/1")
    del run.artifacts["scene_model.safetensors"]
    with pytest.raises(ModelNotFoundError, match="keeps no weights"):
        kept.fetch("scene-model/1")
    assert (kept.folder / "fetched").read_bytes() == b"one"
