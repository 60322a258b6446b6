"""The bundles that ship answer their golden requests."""

from pathlib import Path

import numpy as np
import pytest

from cspace.bundle import Bundle
from cspace.bundle.files import GOLDEN_FILE, SPEC_FILE
from cspace.bundle.golden import GoldenCase
from services.registry.entities import SHIPPED

FOLDERS = [Path(__file__).parents[2] / "inference_api" / folder for folder in SHIPPED.values()]


@pytest.mark.parametrize("folder", FOLDERS, ids=lambda folder: folder.name)
def test_a_shipped_bundle_answers_its_golden_request(folder: Path) -> None:
    bundle = Bundle.load(folder, replay=False)
    assert bundle.spec.to_json() == (folder / SPEC_FILE).read_bytes()
    case = GoldenCase.from_npz((folder / GOLDEN_FILE).read_bytes())
    found = bundle.golden_answer(case.image, case.query)
    np.testing.assert_allclose(found.samples, case.samples, atol=1e-4)
    assert found.confidence is not None
    assert case.confidence is not None
    np.testing.assert_allclose(found.confidence, case.confidence, atol=1e-4)
