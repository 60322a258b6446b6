import numpy as np
import pytest

from cspace.bundle import Bundle
from services.evaluator import job, recalibrate
from services.registry import promotion


@pytest.fixture
def rng():
    return np.random.default_rng(20)


@pytest.fixture
def verified_here(monkeypatch):
    """Bundles are verified in this process: to start a worker takes longer than to evaluate a tiny model."""
    for module in (job, promotion, recalibrate):
        monkeypatch.setattr(
            module, "load_verified", lambda folder, digest=None: Bundle.load(folder, digest=digest)
        )
