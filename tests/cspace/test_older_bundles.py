"""Bundles as earlier releases wrote them load, and answer their golden requests.

To the bit on the machine that made them; within the rounding of single precision on any other.
"""

from pathlib import Path

import numpy as np
import pytest

from cspace.bundle import Bundle
from cspace.bundle.golden import GoldenCase
from cspace.worlds.planar.arm import TWO_LINK, PlanarArm
from cspace.worlds.planar.world import PlanarWorld

FOLDER = Path(__file__).with_name("bundles")
SHIPPED = Path(__file__).parents[2] / "inference_api" / "pretrained"
LIMITED = PlanarArm(joint_limits_rad=(None, (-1.0, 2.0)))


# The last is one whose generators' weights are stacked, and whose head reads rows of pixels.
@pytest.mark.parametrize(
    "folder",
    [FOLDER / "schema_2", SHIPPED, FOLDER / "stacked_mixture"],
    ids=["schema 2", "shipped", "stacked mixture"],
)
def test_an_older_bundle_answers_its_golden_request(folder: Path) -> None:
    bundle = Bundle.load(folder)
    case = GoldenCase.from_npz((folder / "golden.npz").read_bytes())
    assert bundle.spec.world == PlanarWorld(TWO_LINK)
    found = bundle.answer(case.image, case.query)
    np.testing.assert_allclose(found.samples, case.samples, atol=1e-4)
    assert found.confidence is not None
    assert case.confidence is not None
    np.testing.assert_allclose(found.confidence, case.confidence, atol=1e-4)


def test_an_older_bundle_of_an_arm_with_limits_loads_and_keeps_to_them() -> None:
    bundle = Bundle.load(FOLDER / "schema_2_limits")
    assert bundle.spec.world == PlanarWorld(LIMITED)
    assert b'"torus"' in (FOLDER / "schema_2_limits" / "bundle.json").read_bytes()
    assert bundle.spec.joint_space["kind"] == "mixed"
    case = GoldenCase.from_npz((FOLDER / "schema_2_limits" / "golden.npz").read_bytes())
    assert not LIMITED.space.holds(case.samples).all()
    found = bundle.sample(case.image, 2000, 1)
    assert LIMITED.space.holds(found.samples).all()
