import numpy as np
import pytest

from cspace.bundle import Bundle
from cspace.errors import BundleIntegrityError
from services.evaluator.measures.scenes import PackedBundle, unfiltered
from services.planner.samples import BundleSampler
from tests.bundles import picture, write_tiny_bundle


def test_a_bundle_is_judged_by_all_that_it_draws_for_picture_and_seed(tmp_path):
    bundle = Bundle.load(write_tiny_bundle(tmp_path / "bundle", validity=True))
    drawn = unfiltered(BundleSampler(bundle), picture(), 20, 7)
    np.testing.assert_array_equal(drawn, bundle.sample(picture(), 20, 7, min_confidence=0.0).samples)
    assert (drawn.shape, drawn.dtype) == ((20, 2), np.float64)


def test_a_packed_bundle_arrives_as_it_was(tmp_path):
    bundle = Bundle.load(write_tiny_bundle(tmp_path / "bundle", validity=True))
    packed = PackedBundle.pack(bundle)
    arrived = packed.load()
    assert arrived.digest == bundle.digest
    assert not arrived.folder.exists()
    np.testing.assert_array_equal(
        unfiltered(BundleSampler(arrived), picture(), 9, 3),
        unfiltered(BundleSampler(bundle), picture(), 9, 3),
    )


def test_a_packed_bundle_is_verified_on_arrival(tmp_path):
    packed = PackedBundle.pack(Bundle.load(write_tiny_bundle(tmp_path / "bundle")))
    damaged = PackedBundle(packed.digest, packed.files | {"generator.onnx": b"other"})
    with pytest.raises(BundleIntegrityError):
        damaged.load()
