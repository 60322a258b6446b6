import pytest

from cspace.bundle import Bundle
from services.evaluator import job, recalibrate
from services.registry import promotion


@pytest.fixture
def verified_here(monkeypatch: pytest.MonkeyPatch) -> None:
    """Bundles are verified in this process: to start a worker takes longer than to evaluate a tiny model."""
    for module in (job, promotion, recalibrate):
        monkeypatch.setattr(
            module, "load_verified", lambda folder, digest=None: Bundle.load(folder, digest=digest)
        )
