from dataclasses import dataclass, field

import numpy as np
import pytest

from cspace.bundle import Bundle
from cspace.errors import BundleIntegrityError
from cspace.worlds.planar.arm import THREE_LINK
from cspace.worlds.planar.picture import decode_png
from services.evaluator.measures.samplers import BundleSampler, HttpSampler, PackedBundle, UniformSampler
from tests.bundles import picture, write_tiny_bundle


@dataclass
class FakeBatch:
    samples: np.ndarray


@dataclass
class FakeClient:
    calls: list = field(default_factory=list)

    def sample(self, image_png, n, **options):
        self.calls.append((image_png, n, options))
        return FakeBatch(np.zeros((n, 2), dtype=np.float32))


def test_a_bundle_is_sampled_with_picture_and_seed(tmp_path):
    bundle = Bundle.load(write_tiny_bundle(tmp_path / "bundle"))
    drawn = BundleSampler(bundle).sample(picture(), 20, 7)
    np.testing.assert_array_equal(drawn, bundle.sample(picture(), 20, 7).samples)
    assert drawn.shape == (20, 2)


def test_the_validity_head_may_leave_fewer_samples(tmp_path):
    bundle = Bundle.load(write_tiny_bundle(tmp_path / "bundle", validity=True))
    everything = BundleSampler(bundle).sample(picture(), 200, 7)
    some = BundleSampler(bundle, min_confidence=0.7).sample(picture(), 200, 7)
    assert 0 < len(some) < len(everything) == 200


def test_the_http_sampler_sends_the_picture_as_png_with_model_and_seed():
    client = FakeClient()
    drawn = HttpSampler(client, "cspace-sampler/4").sample(picture(), 5, 9)
    png, n, options = client.calls[0]
    np.testing.assert_array_equal(decode_png(png), picture())
    assert (n, drawn.shape) == (5, (5, 2))
    assert options == {"model": "cspace-sampler/4", "seed": 9, "epsilon_sigma": (), "min_confidence": 0.0}


def test_uniform_samples_stay_in_the_joint_space_and_follow_the_seed():
    sampler = UniformSampler(THREE_LINK.space)
    first, again, other = (sampler.sample(picture(), 50, seed) for seed in (1, 1, 2))
    assert first.dtype == np.float32
    assert first.shape == (50, 3)
    assert (np.abs(first.astype(np.float64)) < np.pi).all()
    np.testing.assert_array_equal(first, again)
    assert not np.array_equal(first, other)


def test_a_packed_bundle_arrives_as_it_was(tmp_path):
    bundle = Bundle.load(write_tiny_bundle(tmp_path / "bundle", validity=True))
    packed = PackedBundle.pack(bundle)
    arrived = packed.load()
    assert arrived.digest == bundle.digest
    assert not arrived.folder.exists()
    np.testing.assert_array_equal(
        BundleSampler(arrived).sample(picture(), 9, 3), BundleSampler(bundle).sample(picture(), 9, 3)
    )


def test_a_packed_bundle_is_verified_on_arrival(tmp_path):
    packed = PackedBundle.pack(Bundle.load(write_tiny_bundle(tmp_path / "bundle")))
    damaged = PackedBundle(packed.digest, packed.files | {"generator.onnx": b"other"})
    with pytest.raises(BundleIntegrityError):
        damaged.load()
